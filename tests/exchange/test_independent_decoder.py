"""What docs/delta-format.md says is enough to read deltas with."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from terrafuse.exchange.coarse import CoarseContribution
from terrafuse.exchange.codec import decode, encode
from terrafuse.exchange.delta import Delta
from terrafuse.exchange.profiles import PROFILES, report
from terrafuse.lattice import Lattice
from terrafuse.logs.base import parse_source
from terrafuse.logs.kitti import open_kitti
from terrafuse.mapper import Mapper
from terrafuse.models import make_model
from terrafuse.models.base import Model
from terrafuse.testing.scans import cloud, mixed_scans
from terrafuse.types import Scan
from tests.exchange import independent_decoder
from tests.exchange.golden import GOLDEN
from tests.exchange.make_golden import MODELS

FORMS = ["exact", "full", "lean"]


def assert_read_alike(message: bytes, model: Model) -> None:
    ours = decode(message, model.cell)
    header, tiles = independent_decoder.decode(message)
    assert (header["robot"], header["revision"], header["stamp_ns"]) == (ours.robot, ours.revision, ours.stamp_ns)
    assert sorted(tiles) == [(tile.key.x, tile.key.y) for tile in ours.tiles]
    profile = PROFILES[model.name].get(FORMS[message[4]])
    names = model.cell.names if profile is None else [quantity.name for quantity in profile.quantities]
    for tile in ours.tiles:
        at, stamps, revisions, numbers = zip(*tiles[tile.key.x, tile.key.y], strict=True)
        np.testing.assert_array_equal(at, tile.at)
        np.testing.assert_array_equal(stamps, tile.cells["stamp"])
        np.testing.assert_array_equal(revisions, tile.cells["revision"])
        sent = [tile.cells[name] for name in names] if profile is None else profile.numbers(tile.cells)
        np.testing.assert_array_equal([[one[name] for one in numbers] for name in names], sent)


@pytest.mark.parametrize("name", GOLDEN)
def test_it_reads_golden_bytes(name: str) -> None:
    assert_read_alike(GOLDEN[name], MODELS[name.split()[0]])


def recorded(model: Model, scans: list[Scan], factor: int = 1) -> Delta:
    mapper = Mapper("r1", Lattice(0.5, 40.0), model)
    for scan in scans:
        mapper.integrate(scan)
    if factor == 1:
        return mapper.delta()
    coarse = CoarseContribution(mapper, factor)
    coarse.update()
    return coarse.delta()


@pytest.mark.parametrize("profile", FORMS)
@pytest.mark.parametrize("name", ["elevation", "terrain", "occupancy"])
def test_it_reads_what_robots_send(name: str, profile: str) -> None:
    model = make_model(name)
    delta = recorded(model, mixed_scans(5, 4, (cloud,)))
    assert_read_alike(encode(report(delta, profile, model)), model)


@pytest.mark.parametrize("profile", ["full", "lean"])
@pytest.mark.parametrize(("name", "factor"), [("elevation", 10), ("terrain", 10), ("terrain", 2)])
def test_it_reads_a_recorded_drive(recordings: Path, name: str, factor: int, profile: str) -> None:
    source = f"{recordings / 'lidar3d/patchworkpp_kitti'}?poses=poses_velo_first6.txt&calib=identity"
    scans = [scan for scan in open_kitti(parse_source(source)).scans() if isinstance(scan, Scan)]
    model = make_model(name)
    assert_read_alike(encode(report(recorded(model, scans[:3], factor), profile, model)), model)
