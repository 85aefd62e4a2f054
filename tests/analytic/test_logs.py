"""Recordings in the analytic world, read back like anybody's, and the map that they make against the world's truth."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from terrafuse.errors import InputError
from terrafuse.lattice import Lattice
from terrafuse.logs import open_log
from terrafuse.mapper import Mapper
from terrafuse.replica import Replica
from terrafuse.testing.analytic.scene import Scene, covered, scan, truth
from terrafuse.testing.analytic.world import LIDAR, ROUNDS, SCENE, T_BASE_SENSOR, pose_on
from terrafuse.testing.deltas import scan_of
from terrafuse.types import Bounds, Scan
from tests.analytic.logs import START_NS, write_logs
from tests.analytic.maps import map_of
from tests.analytic.truth import compare

SECONDS = 22.0
"""The car is gone after 17.6 s; the rest is for looking once more."""
LATTICE = Lattice(0.2)


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return write_logs(tmp_path_factory.mktemp("analytic") / "logs", seconds=SECONDS, seed=3)


@pytest.fixture(scope="module")
def with_rule(logs: dict[str, Path]) -> dict[str, int | float]:
    return compare(map_of(logs, LATTICE, static=False))


@pytest.fixture(scope="module")
def without_rule(logs: dict[str, Path]) -> dict[str, int | float]:
    return compare(map_of(logs, LATTICE, static=True))


def test_the_logs_hold_what_was_seen_from_where_it_was_seen(logs: dict[str, Path]) -> None:
    assert sorted(logs) == ["r1", "r2"]
    for number, (robot, path) in enumerate(logs.items()):
        assert path.name == f"{robot}.mcap"
        rng = np.random.default_rng([3, number])
        records = list(open_log(str(path)).scans())
        assert len(records) == 2 * SECONDS
        for k, record in enumerate(records):
            time_s = k / 2
            assert isinstance(record, Scan)
            assert record.stamp_ns == START_NS + k * 500_000_000
            T_world_sensor = pose_on(SCENE.ground, *ROUNDS[robot].place(time_s)) @ T_BASE_SENSOR
            np.testing.assert_allclose(record.T_world_sensor.matrix, T_world_sensor.matrix, atol=1e-9)
            if k < 3:
                np.testing.assert_array_equal(record.points, scan(SCENE, LIDAR, T_world_sensor, time_s, rng))


def test_the_same_seed_writes_the_same_bytes(tmp_path: Path) -> None:
    one, again, other = (
        write_logs(tmp_path / name, seconds=1.0, seed=seed) for name, seed in (("a", 1), ("b", 1), ("c", 2))
    )
    for robot in one:
        assert one[robot].read_bytes() == again[robot].read_bytes()
        assert one[robot].read_bytes() != other[robot].read_bytes()


def test_the_map_is_the_truth(with_rule: dict[str, int | float]) -> None:
    assert with_rule["cells"] > 100_000
    assert with_rule["flat_cells"] > 0.95 * with_rule["cells"]
    assert with_rule["median_error_m"] < 0.003
    assert with_rule["error_95_m"] < 0.01
    assert with_rule["rmse_m"] < 0.03
    assert with_rule["within_5_cm"] > 0.999


def test_the_rule_removes_the_car_s_ghost(
    with_rule: dict[str, int | float], without_rule: dict[str, int | float]
) -> None:
    assert without_rule["ghost_cells"] > 500
    assert with_rule["ghost_cells"] < 0.1 * without_rule["ghost_cells"]
    assert with_rule["rmse_m"] < 0.5 * without_rule["rmse_m"]


def test_walls_stand(with_rule: dict[str, int | float]) -> None:
    assert with_rule["wall_cells_up"] > 0.75 * with_rule["wall_cells"] > 300


# --- the comparison itself -------------------------------------------------------------------------------------------

PLACE = LATTICE.cell_window(Bounds(20.0, -8.0, 28.0, 0.0))
"""Around the low crate."""


def made_of(points: np.ndarray) -> Replica:
    mapper = Mapper("r1", LATTICE)
    mapper.integrate(scan_of(points))
    replica = Replica(LATTICE)
    replica.apply(mapper.delta())
    return replica


def perfect(raised: int = 0, by_m: float = 0.5) -> np.ndarray:
    """A point of the truth in every cell of the place, `raised` of those on open ground too high."""
    i, j = np.meshgrid(np.arange(PLACE[0], PLACE[2]), np.arange(PLACE[1], PLACE[3]))
    points = np.stack([LATTICE.cell_centre(i), LATTICE.cell_centre(j), truth(SCENE, LATTICE, PLACE)], axis=-1)
    open_ground = np.argwhere(~covered(SCENE, LATTICE, PLACE, 0.5))
    for row, column in open_ground[:raised]:
        points[row, column, 2] += by_m
    return points.reshape(-1, 3)


def test_a_perfect_map_has_no_error() -> None:
    report = compare(made_of(perfect()))
    assert json.loads(json.dumps(report, allow_nan=False)) == report
    assert report["cells"] == 1600
    assert report["flat_cells"] + report["wall_cells"] == 1600
    assert 30 < report["wall_cells"] < 100
    assert max(report["median_error_m"], report["rmse_m"], report["error_95_m"]) < 1e-5
    assert (report["within_5_cm"], report["ghost_cells"]) == (1.0, 0)


def test_ghosts_and_errors_are_counted() -> None:
    report = compare(made_of(perfect(raised=40)))
    assert report["ghost_cells"] == 40
    assert report["within_5_cm"] == pytest.approx(1 - 40 / report["flat_cells"])
    assert report["rmse_m"] == pytest.approx(0.5 * math.sqrt(40 / report["flat_cells"]), abs=1e-6)
    assert report["median_error_m"] < 1e-5
    assert compare(made_of(perfect(raised=40, by_m=0.09)))["ghost_cells"] == 0
    assert compare(made_of(perfect(raised=40, by_m=-0.5)))["ghost_cells"] == 0


def test_a_wall_that_the_map_lost_is_not_counted_as_up() -> None:
    up = compare(made_of(perfect()))
    lost = compare(made_of(perfect() * [1, 1, 0] + [0, 0, 1] * ground_of_place()))
    assert up["wall_cells_up"] > 0.3 * up["wall_cells"]
    assert lost["wall_cells_up"] == 0
    assert lost["wall_cells"] == up["wall_cells"]


def ground_of_place() -> np.ndarray:
    return truth(Scene(SCENE.ground), LATTICE, PLACE).reshape(-1, 1)


def test_a_map_that_shows_nothing_is_refused() -> None:
    with pytest.raises(InputError, match="empty"):
        compare(Replica(LATTICE))
