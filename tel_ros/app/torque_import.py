"""From recordings of any arm to a network of its torques, and how good it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tel_ros.core.config import LearningConfig
from tel_ros.core.errors import ConfigError, InputFileError, counted
from tel_ros.core.learning.inputs import InputRange, input_name
from tel_ros.core.learning.joint_recording import JointRecording
from tel_ros.core.learning.learner import Learner, LearnerContext
from tel_ros.core.learning.registry import learner_kind
from tel_ros.core.learning.torque_fit import Fit, TorquePrediction, fit_torque
from tel_ros.core.learning.torque_samples import TorqueSamples, excitation, torque_samples
from tel_ros.core.types import FloatArray
from tel_ros.recording.foreign.plausible import joint_ranges
from tel_ros.recording.foreign.recordings import Wanted, read_sources
from tel_ros.recording.foreign.renaming import renaming
from tel_ros.recording.network_file import revision, save_network
from tel_ros.recording.run_folder import json_ready
from tel_ros.recording.shared_files import named_file
from tel_ros.recording.urdf import arm_description, read_urdf

POOR_NMSE = 0.1


def import_and_train(
    sources: Sequence[Path],
    out: Path,
    *,
    learner: str = "rigid_body",
    urdf: str = "",
    topic: str = "",
    joints: tuple[str, ...] = (),
    rename: Sequence[str] = (),
    rate_hz: float = 200.0,
    cutoff_hz: float | None = None,
    weights: Literal["lms", "least_squares"] = "least_squares",
    max_subtrees: int = 2,
) -> tuple[Fit, dict[str, Any]]:
    """Learn torque from recordings, save the network and report what it is worth.

    The parameters are the options of ``tel train --import``; with 21 inputs each subtree costs much time, and
    after a filter at 15 Hz a rate above 200 Hz adds nothing. Errors are about a source, a setting or the
    network's file, or, as TrainingError, say that too little was recorded or that the result is not finite.

    Returns:
        What was learned, and how good it is, as values that JSON holds: null for what is not finite.
        ``learned_s`` is without the ends of the parts, ``cutoff_hz`` lowest and highest of the filters (half
        of the rate where none was needed), ``torque_std_nm`` the spread of the recorded torques, ``jitter_s``
        the standard deviation of a recording's period.
    """
    if not 0.0 < rate_hz < np.inf:
        raise ConfigError("--rate-hz", rate_hz, "a finite number above 0")
    if cutoff_hz is not None and not 0.0 <= cutoff_hz < np.inf:
        raise ConfigError("--cutoff-hz", cutoff_hz, "0 for no filter, or a finite number above 0")
    if len(set(joints)) < len(joints):
        raise ConfigError("--joints", ",".join(joints), "each joint once")
    if learner.startswith("rigid_body") and not urdf:
        needed = f"the URDF of the arm, whose kinematics the learner {learner} needs"
        raise ConfigError("--urdf", urdf, needed)
    if out.exists():
        raise InputFileError(out, "exists already", "a name that is free")
    kind = learner_kind(learner)
    file = named_file(urdf, Path.cwd()) if urdf else None
    ranges = joint_ranges(read_urdf(file)) if file else {}
    wanted = Wanted(topic=topic, joints=joints, urdf=ranges, renaming=renaming(rename))
    recordings, others, doubts = read_sources(sources, wanted)
    joints = recordings[0].joints
    urdf_text, assumed = arm_description(file, joints, others) if file else ("", [])
    samples = (torque_samples(recording, cutoff_hz=cutoff_hz, most_hz=rate_hz) for recording in recordings)
    parts = [part for parts in samples for part in parts]
    # All blocks are of the same arm, and what lies outside the recorded range is reported as extrapolated.
    settings: dict[str, Any] = {"detect_change": False, "input_margin": 1.0}
    learning = LearningConfig(name=learner, weights=weights, max_subtrees=max_subtrees, **settings)

    def new_learner(input_range: InputRange, unit_nm: FloatArray, std_factor: FloatArray) -> Learner:
        return kind.new(
            LearnerContext(
                joints=joints,
                stiffness_nm_per_rad=tuple(unit_nm.tolist()),
                damping_nms_per_rad=(0.0,) * len(joints),
                input_range=input_range,
                learning=learning,
                seed=1,
                urdf=urdf_text,
                predicts="torque",
                std_factor=tuple(std_factor.tolist()),
            )
        )

    fit = fit_torque(parts, new_learner)
    excited, held_out = excitation(joints, parts), fit.held_out
    save_network(fit.learner, out)
    report = {
        "network": str(out),
        "revision": revision(fit.learner),
        "predicts": "torque",
        "learner": learner,
        "recordings": [
            {
                "source": recording.source,
                "n_samples": len(recording.time_s),
                "duration_s": recording.duration_s,
                "rate_hz": 1.0 / recording.median_period_s,
                "jitter_s": float(np.std(np.diff(recording.time_s))),
            }
            for recording in recordings
        ],
        "unbroken_parts": len(parts),
        "learned_s": sum(len(part) * part.period_s for part in parts),
        "cutoff_hz": (min(p.bandwidth_hz for p in parts), max(p.bandwidth_hz for p in parts)),
        "held_out": {
            "blocks": fit.n_blocks,
            "block_s": fit.block_s,
            "samples": held_out.n_samples,
            "mean_nmse": float(held_out.nmse.mean()),
            "extrapolated_share": held_out.extrapolated,
        },
        "condition": excited.condition,
        "joints": [
            {
                "joint": each.joint,
                "nmse": float(held_out.nmse[j]),
                "rms_nm": float(held_out.rms_nm[j]),
                "expected_rms_nm": float(held_out.expected_rms_nm[j]),
                "torque_std_nm": fit.learner.context.stiffness_nm_per_rad[j],
                **asdict(each),
            }
            for j, each in enumerate(excited.joints)
        ],
        "warnings": [*doubts, *_fit_warnings(joints, fit, recordings, parts), *excited.warnings(), *assumed],
    }
    return fit, json_ready(report)


def extrapolation_warning(learner: Learner, prediction: TorquePrediction) -> str:
    """Return how much of a prediction is extrapolated, and why; empty if none of it is."""
    n, n_extrapolated = len(prediction.extrapolated), int(np.count_nonzero(prediction.extrapolated))
    if not n_extrapolated:
        return ""
    joints, reasons, columns = learner.context.joints, list[str](), prediction.outside.sum(axis=0)
    if columns.any():
        named = [input_name(joints, int(c)) for c in np.argsort(-columns, kind="stable")[:3] if columns[c]]
        reasons.append(f"outside of the range that was learned ({', '.join(named)})")
    if prediction.uncertain.any():
        named = [j for j, u in zip(joints, np.any(prediction.uncertain, axis=0), strict=True) if u]
        reasons.append(f"as uncertain as a guess ({', '.join(named)})")
    faster = ". A slow recording cannot teach a fast movement" if columns[len(joints) :].any() else ""
    share = f"{n_extrapolated} of {counted(n, 'point')} ({n_extrapolated / n:.1%})"
    return f"{share} are extrapolated: {'; '.join(reasons)}{faster}"


def _fit_warnings(
    joints: Sequence[str], fit: Fit, recordings: Sequence[JointRecording], parts: Sequence[TorqueSamples]
) -> list[str]:
    held_out, found = fit.held_out, []
    poor = [
        f"{joint} {nmse:.3g}" for joint, nmse in zip(joints, held_out.nmse, strict=True) if nmse > POOR_NMSE
    ]
    if poor:
        found.append(
            f"torques that were not learned from are predicted badly (nMSE {', '.join(poor)}; 0 is "
            f"perfect, 1 the mean torque), and {held_out.extrapolated:.0%} of them lay outside of what had "
            "been learned: a learner that knows rigid links (--urdf) needs less data; if it is one, are the "
            "efforts in N·m at the joint, and do names fit columns?"
        )
    whole_s = sum(r.duration_s for r in recordings)
    lost_s = whole_s - sum(len(p) * p.period_s for p in parts)
    if lost_s > 0.1 * whole_s:
        found.append(
            f"{lost_s:.3g} of {whole_s:.3g} s lie in gaps, in parts that are too short, or at the "
            "ends of parts"
        )
    return found
