"""``tel bag export``: a file that other readers open, and layouts whose every curve is in it.

Neither Foxglove nor PlotJuggler can be run here. What stands for them: the reader of MCAP's makers with its
own decoder of ROS 2 messages, and the paths of both layouts, looked up in what that decodes.
"""

from __future__ import annotations

import json
import re
import shutil
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from click.testing import CliRunner, Result
from rosbags.highlevel import AnyReader

from tel_ros.app.bag.layouts import FOXGLOVE_LAYOUT, PLOTJUGGLER_LAYOUT, write_layouts
from tel_ros.app.cli import main
from tel_ros.recording.export.run_export import export

pytest.importorskip("mcap")
DecoderFactory = pytest.importorskip("mcap_ros2.decoder").DecoderFactory

from mcap.reader import make_reader  # noqa: E402

SAMPLE = Path(__file__).parents[3] / "bags" / "sample_run"
_INDEXED = re.compile(r"(\w+)(?:\[(\d+)\])?")


def tel(*arguments: object) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


@dataclass(frozen=True)
class Decoded:
    """An exported file as another reader has it: topic to type, and to the messages."""

    types: Mapping[str, str]
    messages: Mapping[str, list[Any]]
    raw: Counter[tuple[str, int, bytes]]

    def numbers(self, topic: str, fields: list[str]) -> list[float]:
        """Return what a path like ``field.field[1]`` means in each message of a topic."""
        assert topic in self.messages, f"no topic {topic}"
        values = []
        for message in self.messages[topic]:
            value = message
            for field in fields:
                found = _INDEXED.fullmatch(field)
                assert found, field
                value = getattr(value, found[1])
                value = value if found[2] is None else value[int(found[2])]
            values.append(float(value))
        return values


def by_mcap(file: Path) -> Decoded:
    types, messages, raw = {}, {}, Counter()
    with file.open("rb") as opened:
        reader = make_reader(opened, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            types[channel.topic] = schema.name
            messages.setdefault(channel.topic, []).append(decoded)
            raw[channel.topic, message.log_time, message.data] += 1
    return Decoded(types, messages, raw)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the command makes of the sample run. Tests only look at it."""
    made = tmp_path_factory.mktemp("export") / "sample"
    result = tel("bag", "export", SAMPLE, "--out", made)
    assert result.exit_code == 0, result.output
    return made


@pytest.fixture(scope="module")
def decoded(folder: Path) -> Decoded:
    return by_mcap(folder / "sample.mcap")


def test_another_reader_finds_what_rosbags_finds(folder: Path, decoded: Decoded) -> None:
    with AnyReader([folder]) as reader:
        ours = Counter((c.topic, time_ns, bytes(raw)) for c, time_ns, raw in reader.messages())
    assert decoded.raw == ours
    recorded = Counter()
    for name in ("trial_001", "trial_002"):
        recorded += by_mcap(SAMPLE / name / f"{name}.mcap").raw
    assert recorded <= decoded.raw


def test_another_reader_finds_a_topic_by_the_index(folder: Path) -> None:
    """Players jump: they read single chunks, by the index at the end of the file."""
    with (folder / "sample.mcap").open("rb") as opened:
        reader = make_reader(opened)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.chunk_indexes
        assert all(chunk.message_index_offsets for chunk in summary.chunk_indexes)
        found = [m.log_time for _, _, m in reader.iter_messages("/practice/trial_result")]
    assert found == [9_636_000_000, 14_310_000_000]


def mosaic_leaves(node: Any) -> Iterator[str]:
    if isinstance(node, str):
        yield node
    else:
        assert set(node) == {"first", "second", "direction", "splitPercentage"}
        assert node["direction"] in ("row", "column")
        yield from mosaic_leaves(node["first"])
        yield from mosaic_leaves(node["second"])


def test_foxgloves_layout_shows_each_of_its_panels_once(folder: Path) -> None:
    layout = json.loads((folder / FOXGLOVE_LAYOUT).read_text(encoding="utf-8"))
    shown = list(mosaic_leaves(layout["layout"]))
    for tab in layout["configById"]["Tab!joints"]["tabs"]:
        shown += mosaic_leaves(tab["layout"])
    assert Counter(shown) == Counter(layout["configById"].keys())
    assert [tab["title"] for tab in layout["configById"]["Tab!joints"]["tabs"]] == ["shoulder", "elbow"]


def foxglove_numbers(decoded: Decoded, path: str) -> list[float]:
    """Resolve a message path: the topic is everything before the first dot."""
    topic, *fields = path.split(".")
    return decoded.numbers(topic, fields)


def test_every_path_of_foxgloves_layout_is_in_the_file(folder: Path, decoded: Decoded) -> None:
    panels = json.loads((folder / FOXGLOVE_LAYOUT).read_text(encoding="utf-8"))["configById"]
    paths = [series["value"] for panel in panels.values() for series in panel.get("paths", ())]
    assert len(paths) == 1 + 2 * (3 + 1 + 3)
    for path in paths:
        assert foxglove_numbers(decoded, path)
    assert panels["RawMessages!result"]["topicPath"] in decoded.messages
    shown = {topic: decoded.types[topic] for topic in panels["3D!arm"]["topics"]}
    assert Counter(shown.values()) == {"std_msgs/msg/String": 1, "nav_msgs/msg/Path": 3}
    children = {t.child_frame_id for m in decoded.messages["/tf"] for t in m.transforms}
    assert panels["3D!arm"]["followTf"] not in children


def plotjuggler_numbers(decoded: Decoded, curve: str) -> list[float]:
    """Resolve a curve's name: a topic, then fields, all divided by slashes."""
    topic = next(topic for topic in decoded.messages if curve.startswith(f"{topic}/"))
    return decoded.numbers(topic, curve.removeprefix(f"{topic}/").split("/"))


def test_every_curve_of_plotjugglers_layout_is_in_the_file_and_is_loaded(
    folder: Path, decoded: Decoded
) -> None:
    root = ElementTree.parse(folder / PLOTJUGGLER_LAYOUT).getroot()
    curves = [curve.attrib["name"] for curve in root.iter("curve")]
    assert len(curves) == 1 + 2 * (3 + 1 + 3)
    (loaded,) = root.iter("fileInfo")
    assert (folder / loaded.attrib["filename"]).is_file()
    (parameters,) = root.iter("parameters")
    topics = parameters.attrib["selected_topics"].split(";")
    assert set(topics) <= set(decoded.messages)
    for curve in curves:
        assert plotjuggler_numbers(decoded, curve)
        assert any(curve.startswith(f"{topic}/") for topic in topics)


def test_splitters_of_plotjugglers_layout_count_their_plots(folder: Path) -> None:
    splitters = list(ElementTree.parse(folder / PLOTJUGGLER_LAYOUT).getroot().iter("DockSplitter"))
    assert [int(each.attrib["count"]) for each in splitters] == [len(each) for each in splitters] == [3, 3, 1]
    assert all(len(each.attrib["sizes"].split(";")) == len(each) for each in splitters)


def test_both_layouts_show_the_same_numbers(folder: Path, decoded: Decoded) -> None:
    panels = json.loads((folder / FOXGLOVE_LAYOUT).read_text(encoding="utf-8"))["configById"].values()
    foxglove = [foxglove_numbers(decoded, s["value"]) for panel in panels for s in panel.get("paths", ())]
    curves = ElementTree.parse(folder / PLOTJUGGLER_LAYOUT).getroot().iter("curve")
    plotjuggler = [plotjuggler_numbers(decoded, curve.attrib["name"]) for curve in curves]
    assert sorted(map(str, foxglove)) == sorted(map(str, plotjuggler))


def test_a_path_that_is_not_in_the_file_is_found(decoded: Decoded) -> None:
    with pytest.raises(AssertionError, match="no topic /nothing"):
        foxglove_numbers(decoded, "/nothing.data[0]")
    with pytest.raises(AttributeError):
        foxglove_numbers(decoded, "/ep_controller/state.nothing")
    with pytest.raises(IndexError):
        plotjuggler_numbers(decoded, "/ep_controller/state/position_rad[2]")


def test_layouts_take_any_name_of_a_joint(tmp_path: Path) -> None:
    made = export(SAMPLE / "trial_002", tmp_path / "out")
    odd = ('a"b', "<c>&'d")
    arm = replace(made.arm, config=replace(made.arm.config, joints=odd))
    foxglove, plotjuggler = write_layouts(replace(made, arm=arm))
    panels = json.loads(foxglove.read_text(encoding="utf-8"))["configById"]
    assert [tab["title"] for tab in panels["Tab!joints"]["tabs"]] == list(odd)
    tabs = [tab.attrib["tab_name"] for tab in ElementTree.parse(plotjuggler).getroot().iter("Tab")]
    assert tabs == [*odd, "trials"]


def test_json_tells_everything_that_was_made(tmp_path: Path) -> None:
    run = shutil.copytree(SAMPLE, tmp_path / "run")
    (run / "trial_001" / "metadata.yaml").unlink()
    result = tel("bag", "export", run, "--out", tmp_path / "out", "--json")
    assert result.exit_code == 1
    assert "tel: trial_001 is left out: it is unfinished" in result.stderr
    told = json.loads(result.stdout)
    assert all(Path(told[key]).is_file() for key in ("file", "foxglove_layout", "plotjuggler_layout"))
    assert [(trial["index"], trial["shift_s"]) for trial in told["trials"]] == [(2, 0.0)]
    assert [Path(each["bag"]).name for each in told["left_out"]] == ["trial_001"]
    assert (told["topics"]["/practice/trial_result"], told["meshes"]) == (1, [])


def test_what_cannot_be_exported_is_said_in_a_line(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    for source, out, said in (
        (SAMPLE, tmp_path / "there", "exists already"),
        (tmp_path / "nothing", tmp_path / "out", "there is no such file or folder"),
        (tmp_path / "there", tmp_path / "out", "is a folder without metadata.yaml and data files"),
    ):
        result = tel("bag", "export", source, "--out", out)
        assert (result.exit_code, result.stderr.count("\n")) == (2, 1)
        assert said in result.stderr
    assert not (tmp_path / "out").exists()
