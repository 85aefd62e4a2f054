"""The one idea: the map is a pure function of what each robot reports."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from terrafuse.errors import DeltaError, InputError, LatticeError
from terrafuse.exchange.codec import decode, encode
from terrafuse.exchange.delta import Delta
from terrafuse.lattice import Lattice
from terrafuse.logs import open_log
from terrafuse.mapper import Mapper
from terrafuse.models import make_model
from terrafuse.replica import Replica, check_robots
from terrafuse.testing.deltas import deltas_of, random_scans
from terrafuse.testing.stores import LATTICE, MODEL
from terrafuse.types import Scan

ROBOTS = ("r1", "r2", "r3")
DELTAS = [d for k, name in enumerate(ROBOTS) for d in deltas_of(name, random_scans(k, 6), LATTICE, MODEL)]


def digest_of(deltas: list[Delta]) -> str:
    replica = Replica(LATTICE, MODEL)
    for delta in deltas:
        replica.apply(delta)
    return replica.digest()


EXPECTED = digest_of(DELTAS)


@given(st.permutations(DELTAS), st.lists(st.integers(0, len(DELTAS) - 1), max_size=12))
@settings(max_examples=100)
def test_any_order_and_repetition_gives_the_same_bytes(order: list[Delta], again: list[int]) -> None:
    assert digest_of(order + [DELTAS[k] for k in again]) == EXPECTED


@given(st.permutations(DELTAS), st.integers(0, len(DELTAS)))
@settings(max_examples=30)
def test_reading_in_between_changes_nothing(order: list[Delta], when: int) -> None:
    replica = Replica(LATTICE, MODEL)
    for k, delta in enumerate(order):
        if k == when:
            replica.digest()
        replica.apply(delta)
    assert replica.digest() == EXPECTED


def test_deltas_since_any_revision_meet_in_the_same_map() -> None:
    """A robot may report in whatever pieces: one delta over all, or overlapping ones."""
    mapper = Mapper("r1", LATTICE, MODEL)
    pieces = []
    for scan in random_scans(0, 6):
        mapper.integrate(scan)
        pieces.append(mapper.delta(max(0, mapper.revision - 3)))
    assert (
        digest_of(pieces)
        == digest_of([mapper.delta(0)])
        == digest_of(deltas_of("r1", random_scans(0, 6), LATTICE, MODEL))
    )


def test_a_robot_can_be_left_out() -> None:
    replica = Replica(LATTICE, MODEL)
    for delta in DELTAS:
        replica.apply(delta)
    without = Replica(store=replica.store, without=["r2"])
    assert without.digest() == digest_of([delta for delta in DELTAS if delta.robot != "r2"])
    assert Replica(store=replica.store, only=["r2"]).digest() == digest_of([d for d in DELTAS if d.robot == "r2"])
    with pytest.raises(InputError, match="no robot 'r9' in this store; it has: r1, r2, r3"):
        check_robots(replica.store, ["r9"])


def test_a_delta_of_another_map_changes_nothing() -> None:
    replica = Replica(LATTICE, MODEL)
    (foreign,) = deltas_of("r1", random_scans(0, 1), Lattice(0.5, 4.0, "EPSG:32632"), MODEL)
    with pytest.raises(DeltaError, match="EPSG:32632"):
        replica.apply(foreign)
    assert replica.keys == []


def test_layers_come_as_xarray() -> None:
    pytest.importorskip("xarray")
    replica = Replica(LATTICE, MODEL)
    for delta in DELTAS:
        replica.apply(delta)
    height = replica.layer("height", (-2, -2, 2, 2))
    assert height.dims == ("y", "x")
    assert height.shape == (8, 8)
    assert height.y[0] > height.y[-1]
    with pytest.raises(InputError, match="no layer 'hieght'; it has: height"):
        replica.layer("hieght")
    with pytest.raises(LatticeError, match="hold no cell"):
        replica.layer("height", (1, 1, 1, 1))


# --- a real log, cut into robots -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def kitti(recordings: Path) -> list[Scan]:
    source = f"{recordings / 'lidar3d/patchworkpp_kitti'}?poses=poses_velo_first6.txt&calib=identity"
    return [record for record in open_log(source).scans() if isinstance(record, Scan)]


@pytest.mark.parametrize("robots", [2, 3, 5])
def test_a_real_log_cut_into_robots(kitti: list[Scan], robots: int) -> None:
    """n, z_min, z_max, mean and variance of the fold equal those of one robot that saw all: exactly, in every bit."""
    lattice, model = Lattice(0.2), make_model("elevation", {"static": True})
    one = Replica(lattice, model)
    for delta in deltas_of("all", kitti, lattice, model, every=6):
        one.apply(delta)
    deltas = [d for r in range(robots) for d in deltas_of(f"r{r}", kitti[r::robots], lattice, model)]
    digests = set()
    for seed in range(4):
        rng = np.random.default_rng(seed)
        messages = [encode(delta) for delta in deltas]
        replica = Replica(lattice, model)
        for k in [*rng.permutation(len(messages)), *rng.integers(0, len(messages), 5)]:
            replica.apply(decode(messages[k], model.cell))
        digests.add(replica.digest())
    assert len(digests) == 1
    assert replica.keys == one.keys
    for key in one.keys:
        for field in ("n", "z_min", "z_max", "z_sum", "sq_lo", "sq_hi", "merges", "stamp"):
            np.testing.assert_array_equal(replica.cells(key)[field], one.cells(key)[field])
