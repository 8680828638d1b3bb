"""What the page draws of a path."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("viser", reason="needs the extra view")

from tel_ros.app.view.page import segments  # noqa: E402

NOWHERE = np.full((1, 3), np.nan)


def test_a_path_is_drawn_from_point_to_point_but_not_over_its_gaps() -> None:
    points_m = np.arange(12.0).reshape(4, 3)
    drawn = segments(np.concatenate([points_m[:2], NOWHERE, points_m[2:]]))
    assert drawn.tolist() == [points_m[:2].tolist(), points_m[2:].tolist()]


@pytest.mark.parametrize("points_m", [np.zeros((0, 3)), np.ones((1, 3)), NOWHERE])
def test_of_no_path_there_is_something_to_send_that_shows_nothing(points_m: np.ndarray) -> None:
    drawn = segments(points_m)
    assert drawn.shape == (1, 2, 3)
    assert not drawn.any()
