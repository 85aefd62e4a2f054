"""Sensors in worlds whose readings are worked out by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from terrafuse.errors import InputError
from terrafuse.sense import Beams, Mounting, Ring, Sensor, load_sensor
from terrafuse.simulate.movers import NO_BODIES, body
from terrafuse.simulate.rays import RayCaster
from terrafuse.simulate.sensors import Lidar, Sonar, fired, firings, lidar_scan, sonar_ranges, sonar_scan
from terrafuse.simulate.sensors.codes import walsh_hadamard
from terrafuse.simulate.sensors.crosstalk import Ping, false_echoes, sound_paths
from terrafuse.types import Pose
from tests.simulate.places import room

pytest.importorskip("embreex")

PLANE = Sensor("2D", 10.0, beams=Ring(8, 0.0, math.pi / 4), noise_sigma_m=0.01, mounting=Mounting(z_m=0.5))
NOMAD = load_sensor("nomad_200_sonar")
SOCCER = load_sensor("soccer_robot_sonar")
LEVEL = Pose.from_quaternion((0, 0, 0), (0, 0, 0, 1))


def raised(sensor: Sensor, z_m: float) -> Sensor:
    return replace(sensor, mounting=Mounting(z_m=z_m))


def at(x: float, y: float, yaw: float = 0.0) -> Pose:
    return Pose.from_quaternion((x, y, 0), (0, 0, math.sin(yaw / 2), math.cos(yaw / 2)))


def test_a_lidar_in_a_room_reads_its_walls() -> None:
    """Walls 2 m away: 2 m along the axes, 2√2 m into the corners; the points lie in the sensor's frame."""
    scan = lidar_scan(Lidar(PLANE), RayCaster(room()), at(0, 0, math.pi / 2), 7)
    assert scan.stamp_ns == 7
    assert scan.T_world_sensor.position.tolist() == [0, 0, 0.5]
    expected = [(2, 0), (2, 2), (0, 2), (-2, 2), (-2, 0), (-2, -2), (0, -2), (2, -2)]
    np.testing.assert_allclose(scan.points[:, :2], expected, atol=1e-9)


def test_noise_is_along_the_beam_and_as_large_as_described() -> None:
    caster, lidar, rng = RayCaster(room()), Lidar(PLANE), np.random.default_rng(0)
    scans = [lidar_scan(lidar, caster, LEVEL, 0, NO_BODIES, rng) for _ in range(500)]
    ranges = np.array([np.linalg.norm(scan.points, axis=1) for scan in scans])
    np.testing.assert_allclose(ranges.mean(axis=0), [2, 8**0.5] * 4, atol=4 * 0.01 / np.sqrt(500))
    assert np.std(ranges - ranges.mean(axis=0)) == pytest.approx(0.01, rel=0.05)


def test_dropouts_and_silence_read_as_no_echo() -> None:
    """Walls in reach along the axes, corners not: 4 points. What drops out is silent, and clears as silence does."""
    near = replace(PLANE, max_range_m=2.5, noise_sigma_m=0.0, no_return="clear")
    caster = RayCaster(room())
    scan = lidar_scan(Lidar(near), caster, LEVEL, 0)
    assert len(scan.points) == 4
    assert scan.misses is not None
    np.testing.assert_allclose(np.linalg.norm(scan.misses, axis=1), 2.5)
    none = lidar_scan(Lidar(near, dropout=1.0), caster, LEVEL, 0, NO_BODIES, np.random.default_rng(0))
    assert len(none.points) == 0
    ignored = lidar_scan(Lidar(replace(near, no_return="ignore")), caster, LEVEL, 0)
    assert ignored.dropped == {"no return": 4}
    lost = [
        8 - len(lidar_scan(Lidar(PLANE, 0.25), caster, LEVEL, 0, NO_BODIES, np.random.default_rng(k)).points)
        for k in range(400)
    ]
    assert np.mean(lost) == pytest.approx(2.0, abs=4 * math.sqrt(8 * 0.25 * 0.75 / 400))


def test_the_same_stream_of_numbers_gives_the_same_scans() -> None:
    """Also for a robot whose neighbour stands elsewhere: each scan takes as many numbers, whatever it sees."""
    caster, lidar = RayCaster(room()), Lidar(PLANE, dropout=0.1)

    def run(seed: int, other_x: float) -> list[bytes]:
        rng = np.random.default_rng(seed)
        there = body("person", other_x, 0.0, 0.0, 0.0)
        scans = [lidar_scan(lidar, caster, LEVEL, 0, bodies, rng) for bodies in (NO_BODIES, there, NO_BODIES)]
        return [scan.points.tobytes() for scan in scans]

    near, again, far, other = run(0, 1.0), run(0, 1.0), run(0, 9.0), run(1, 1.0)
    assert near == again
    assert [near[0], near[2]] == [far[0], far[2]]
    assert near[1] != far[1]
    assert near[0] != other[0]


def test_a_sonar_that_faces_a_wall_reads_the_distance() -> None:
    """A ring of radius 0.225 m in the middle of a room of ±1 m: 0.775 m to the walls that it faces. Of the walls 22.5°
    off, the rim of the cone (12.5°) meets one at 10°: at x = 1 from 0.225·cos 22.5°, (1 - 0.2079)/cos 10° = 0.8043 m.
    The sonars at 45° meet both walls at 32.5° at best, beyond the specular limit of 20°: they hear nothing."""
    sonar = Sonar(raised(NOMAD, 0.8))
    ranges = sonar_ranges(sonar, RayCaster(room(2.0)), LEVEL)
    np.testing.assert_allclose(ranges[[0, 4, 8, 12]], 0.775, atol=1e-9)
    np.testing.assert_allclose(ranges[[1, 3, 5, 7, 9, 11, 13, 15]], 0.8043, atol=1e-4)
    np.testing.assert_array_equal(ranges[[2, 6, 10, 14]], NOMAD.max_range_m)


def test_a_rough_wall_is_heard_however_it_is_met() -> None:
    """At 45°, the rim meets a wall at 32.5°: from 0.225·cos 45°, (1 - 0.1591)/cos 32.5° = 0.9971 m."""
    ranges = sonar_ranges(Sonar(raised(NOMAD, 0.8), specular_limit_rad=math.pi / 2), RayCaster(room(2.0)), LEVEL)
    np.testing.assert_allclose(ranges[[2, 6, 10, 14]], 0.9971, atol=1e-4)


def test_silence_is_a_miss_at_the_maximum_range() -> None:
    scan = sonar_scan(Sonar(raised(NOMAD, 0.8)), RayCaster(room(20.0)), LEVEL, 5)
    assert len(scan.points) == 0
    assert scan.misses is not None
    np.testing.assert_allclose(np.hypot(*scan.misses[:, :2].T), 0.225 + 1.27)
    assert scan.beam.half_angle_rad == NOMAD.cone_half_angle_rad


def test_the_ground_gives_no_echo_but_a_round_robot_does() -> None:
    """0.3 m above the ground, the rim of a cone meets it at 78° at best. A robot of radius 0.2 m, 2 m away: 1.8 m."""
    sonar, caster = Sonar(raised(SOCCER, 0.3)), RayCaster(room(20.0))
    np.testing.assert_array_equal(sonar_ranges(sonar, caster, LEVEL), 3.0)
    ranges = sonar_ranges(sonar, caster, LEVEL, body("soccer", 2.0, 0.0, 0.0, 0.0))
    assert ranges[0] == pytest.approx(1.8)
    assert (ranges[3:14] == 3.0).all()


def test_sonars_fire_in_turn() -> None:
    """20 ms apart, the first at 0: from 0.31 s to 0.36 s number 0 (0.32 s) and 1 (0.34 s)."""
    sonar = Sonar(SOCCER)
    assert firings(sonar, 310_000_000, 360_000_000) == [(320_000_000, 0), (340_000_000, 1)]
    assert [number for _, number in firings(sonar, 0, 320_000_000)] == list(range(16))
    one = fired(Sonar(raised(SOCCER, 0.3)), 4)
    whole = Sonar(raised(SOCCER, 0.3))
    caster = RayCaster(room(4.0))
    np.testing.assert_allclose(sonar_ranges(one, caster, at(0.3, 0.2)), sonar_ranges(whole, caster, at(0.3, 0.2))[4:5])
    with pytest.raises(InputError, match="fires all at once"):
        firings(Sonar(NOMAD), 0, 1)
    with pytest.raises(InputError, match="sonar 16 of soccer_robot_sonar: it has 0 to 15"):
        fired(sonar, 16)


def single(azimuth_rad: float, x: float, y: float, time_s: float = 0.0, code: int = 2) -> Ping:
    sensor = replace(raised(SOCCER, 0.4), beams=Beams((azimuth_rad,), (0.0,)))
    return Ping(Sonar(sensor), at(x, y), time_s, walsh_hadamard()[code])


def test_sound_goes_straight_to_a_sonar_that_looks_back() -> None:
    """2 m apart, face to face: 2 m; back to back: nothing; with a person between: nothing."""
    caster = RayCaster(room(20.0))
    ahead, back = single(0.0, -1.0, 0.0), single(math.pi, 1.0, 0.0)
    assert sound_paths(caster, ahead, back, NO_BODIES).tolist() == [[2.0]]
    assert sound_paths(caster, single(math.pi, -1, 0), back, NO_BODIES).tolist() == [[np.inf]]
    person = body("person", 0.0, 0.0, 0.0, 0.0)
    assert sound_paths(caster, ahead, back, person).tolist() == [[np.inf]]


def test_sound_comes_by_way_of_a_wall() -> None:
    """Both look at a wall 1 m ahead at 45°, 2 m apart: to the wall and back, √2 + √2 m by the mirrored way. Rays of the
    sender's rim leave a shorter one only within the receiver's cone: not below the straight 2 m, and not far below."""
    caster = RayCaster(room(4.0))
    one, other = single(math.pi / 4, -1.0, 1.0), single(3 * math.pi / 4, 1.0, 1.0)
    path = sound_paths(caster, one, other, NO_BODIES)[0, 0]
    assert path == pytest.approx(8**0.5, abs=0.02)


def test_false_echoes_are_what_the_correlator_lets_through() -> None:
    """Face to face at 2 m, fired at once: sound comes after 2/343 s and reads as half the way, 1 m."""
    caster = RayCaster(room(20.0))
    ear = single(math.pi, 1.0, 0.0, code=2)
    same = single(0.0, -1.0, 0.0, code=2)
    assert false_echoes(caster, ear, [same], NO_BODIES, "uncoded").tolist() == [pytest.approx(1.0)]
    assert false_echoes(caster, ear, [same], NO_BODIES, "sliding").tolist() == [pytest.approx(1.0)]
    # Aligned: the other fired so that sound arrives 29 · 8 = 232 chips after our ping, which reads as 0.9947 m.
    aligned = single(0.0, -1.0, 0.0, time_s=232 * 25e-6 - 2 / 343, code=3)
    assert false_echoes(caster, ear, [aligned], NO_BODIES, "uncoded").tolist() == [pytest.approx(0.9947, abs=1e-4)]
    assert false_echoes(caster, ear, [aligned], NO_BODIES, "slots").tolist() == [np.inf]
    # One chip early it is -7/8 of an echo at the slot.
    early = single(0.0, -1.0, 0.0, time_s=231 * 25e-6 - 2 / 343, code=3)
    assert false_echoes(caster, ear, [early], NO_BODIES, "slots").tolist() == [pytest.approx(0.9904, abs=1e-4)]
    # Sound that comes before our ping, or after we stop to listen (3 m: 17.5 ms), is no echo.
    for time_s in (-2.5 / 343, 0.0175):
        other = single(0.0, -1.0, 0.0, time_s, code=2)
        assert false_echoes(caster, ear, [other], NO_BODIES, "uncoded").tolist() == [np.inf]


def test_what_can_not_be_simulated_is_refused() -> None:
    with pytest.raises(InputError, match="describes no beams"):
        Lidar(Sensor("cloud", 10.0))
    with pytest.raises(InputError, match="a simulated one needs a finite range"):
        Lidar(replace(PLANE, max_range_m=math.inf))
    with pytest.raises(InputError, match=r"dropout 1.5: give a share from 0 to 1"):
        Lidar(PLANE, dropout=1.5)
    with pytest.raises(InputError, match="cone_half_angle between 0 and 90°"):
        Sonar(PLANE)
    with pytest.raises(InputError, match="specular limit 0 rad"):
        Sonar(SOCCER, specular_limit_rad=0)
