"""Radio: whom a frame reaches, when, and that maps meet over it all the same."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from math import inf
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.errors import InputError
from terrafuse.exchange.links import Cut, Faults, Link
from terrafuse.simulate.radio import Place, Radio, RadioCut, RadioSettings, Surroundings, loss
from terrafuse.testing.links import LinkTests

SECOND_NS = 1_000_000_000
MS = 1_000_000
HERE = (0.0, 0.0, 0.0)
CALM = RadioSettings(range_m=100.0, faults=Faults(overhead_bytes=12))


class TestRadioLink(LinkTests):
    @pytest.fixture
    def join(self) -> Callable[[str], Link]:
        radio = Radio()
        return lambda node: radio.link(node, HERE)


def heard(radio: Radio, sender: Link, receiver: Link, from_ns: int, frames: int, every_ns: int) -> list[int]:
    """Which of these frames arrived, by number, looked at before the next is sent and a while after the last."""
    receiver.listen("x")
    out = []
    for k in range(frames):
        now_ns = from_ns + k * every_ns
        sender.send("x", k.to_bytes(2, "big"), now_ns)
        out += [int.from_bytes(frame.payload, "big") for frame in receiver.receive(now_ns + every_ns - 1)]
    return out


def test_loss_by_hand() -> None:
    """(d/R)⁴ with R = 100 m: at 50 m 1/16, at 30 and 40 m aside (50 m) as much; at 80 m 0.4096; from 100 m on all."""
    free = Surroundings()
    assert loss(CALM, free, HERE, HERE) == 0
    assert loss(CALM, free, HERE, (50.0, 0.0, 0.0)) == 0.0625
    assert loss(CALM, free, (10.0, 0.0, 0.0), (40.0, 0.0, 40.0)) == 0.0625
    assert loss(CALM, free, HERE, (0.0, 80.0, 0.0)) == pytest.approx(0.4096)
    assert loss(CALM, free, HERE, (0.0, 100.0, 0.0)) == loss(CALM, free, HERE, (0.0, 500.0, 0.0)) == 1
    assert loss(replace(CALM, exponent=2.0), free, HERE, (50.0, 0.0, 0.0)) == 0.25


def wall_at_x_5(one: Place, two: Place) -> bool:
    return (one[0] < 5) == (two[0] < 5)


def test_walls_leave_a_share_of_the_range() -> None:
    """Behind the wall R = 0.3·100 m: at 15 m 1/16 is lost, from 30 m on all; on this side of it nothing changes."""
    walls = Surroundings(sight=wall_at_x_5)
    assert loss(CALM, walls, HERE, (15.0, 0.0, 0.0)) == 0.0625
    assert loss(CALM, walls, HERE, (30.0, 0.0, 0.0)) == 1
    assert loss(CALM, walls, HERE, (0.0, 50.0, 0.0)) == 0.0625
    opaque = replace(CALM, behind_walls=0.0)
    assert loss(opaque, walls, HERE, (6.0, 0.0, 0.0)) == 1


def test_without_a_signal_at_either_end_nothing_passes() -> None:
    west_only = Surroundings(communications=lambda x_m, y_m: x_m < 10)
    assert loss(CALM, west_only, HERE, (9.0, 0.0, 0.0)) < 1
    assert loss(CALM, west_only, HERE, (11.0, 0.0, 0.0)) == 1
    assert loss(CALM, west_only, (11.0, 0.0, 0.0), HERE) == 1


def test_latency_and_rate_by_hand() -> None:
    """100 bytes and 12 of header at 1120 bytes/s take 100 ms, and 5 ms more to arrive. Each sender has its own turn."""
    radio = Radio(replace(CALM, faults=Faults(delay_s=0.005, bytes_per_s=1120, overhead_bytes=12)))
    one, two, station = (radio.link(name, HERE) for name in ("one", "two", "station"))
    station.listen("x")
    for sender, payload in ((one, b"a" * 100), (one, b"b" * 100), (two, b"c" * 212)):
        sender.send("x", payload, 0)
    times = {}
    for now_ns in range(0, SECOND_NS, MS):
        times |= {frame.payload[:1]: now_ns // MS for frame in station.receive(now_ns)}
    assert times == {b"a": 105, b"b": 205, b"c": 205}
    assert radio.counts["one"] == {"frames_sent": 2, "bytes_sent": 224}
    assert radio.counts["station"] == {"frames_received": 3, "bytes_received": 3 * 12 + 412}


def test_a_robot_drives_out_of_reach_and_comes_back() -> None:
    """10 m a frame, out and back, without loss before the end of the range: it is silent from 100 m to 100 m."""
    radio = Radio(replace(CALM, exponent=1e9))
    robot, station = radio.link("robot", HERE), radio.link("station", HERE)
    station.listen("x")
    got = []
    for k in range(30):
        radio.move("robot", (10.0 * min(k, 29 - k), 0.0, 0.0), k * MS)
        robot.send("x", bytes([k]), k * MS)
        got += [frame.payload[0] for frame in station.receive(k * MS)]
    assert got == [*range(10), *range(20, 30)]
    assert radio.counts["robot"]["out_of_reach"] == 10


def test_what_counts_is_the_place_when_the_last_byte_leaves() -> None:
    """A frame of a second; the robot is out of reach at its beginning, or at its end."""
    settings = replace(CALM, faults=Faults(bytes_per_s=112, overhead_bytes=12))
    for from_m, to_m, arrives in ((500.0, 1.0, 1), (1.0, 500.0, 0)):
        radio = Radio(settings)
        robot, station = radio.link("robot", (from_m, 0.0, 0.0)), radio.link("station", HERE)
        station.listen("x")
        robot.send("x", bytes(100), 0)
        radio.move("robot", (to_m, 0.0, 0.0), SECOND_NS // 2)
        assert len(station.receive(SECOND_NS)) == arrives


@pytest.mark.parametrize(
    ("cut", "ab", "ac"),
    [
        (RadioCut(0.02, 0.05), [0, 1, 5, 6], [0, 1, 5, 6]),
        (RadioCut(0.02, 0.05, "a"), [0, 1, 5, 6], [0, 1, 5, 6]),
        (RadioCut(0.02, 0.05, "b"), [0, 1, 5, 6], [0, 1, 2, 3, 4, 5, 6]),
        (RadioCut(0.02, inf, "c", "a"), [0, 1, 2, 3, 4, 5, 6], [0, 1]),
        (RadioCut(0.0, inf, "b", "c"), [0, 1, 2, 3, 4, 5, 6], [0, 1, 2, 3, 4, 5, 6]),
    ],
)
def test_cuts_by_script(cut: RadioCut, ab: list[int], ac: list[int]) -> None:
    """Every 10 ms a frame of a to b and c."""
    for name, expected in (("b", ab), ("c", ac)):
        radio = Radio(replace(CALM, cuts=(cut,)))
        links = {node: radio.link(node, HERE) for node in "abc"}
        assert heard(radio, links["a"], links[name], 0, 7, 10 * MS) == expected


def test_frames_get_lost_as_often_as_the_distance_says() -> None:
    """At 84 m 0.84⁴ = 0.498 of 4000 frames, within five standard deviations (5·√(4000·0.25) = 158)."""
    radio = Radio(CALM, seed=3)
    sender, receiver = radio.link("a", HERE), radio.link("b", (84.0, 0.0, 0.0))
    assert abs(len(heard(radio, sender, receiver, 0, 4000, MS)) - 4000 * (1 - 0.84**4)) < 158


def survivors(names: list[str], seed: int) -> list[int]:
    """Of a's frames those that b hears, among these nodes."""
    radio = Radio(CALM, seed=seed)
    links = {name: radio.link(name, (84.0 * (name == "b"), 0.0, 0.0)) for name in names}
    for link in links.values():
        link.listen("x")
    return heard(radio, links["a"], links["b"], 0, 40, MS)


@given(st.integers(0, 2**32))
def test_same_seed_same_run_and_a_robot_more_changes_nothing_for_the_others(seed: int) -> None:
    expected = survivors(["a", "b"], seed)
    assert survivors(["a", "b"], seed) == survivors(["c", "b", "a", "d"], seed) == expected


def test_receivers_fare_independently() -> None:
    radio = Radio(replace(CALM, faults=Faults(loss=0.5)))
    a, b, c = (radio.link(name, HERE) for name in "abc")
    c.listen("x")
    by_b = heard(radio, a, b, 0, 400, MS)
    by_c = [int.from_bytes(frame.payload, "big") for frame in c.receive(400 * MS)]
    # Half of half, within five standard deviations: 5·√(400·¼·¾) = 43.
    assert abs(len(set(by_b) & set(by_c)) - 100) < 43


def test_frames_are_those_of_the_grey_paper() -> None:
    assert Radio().link("r", HERE).max_frame_bytes == 2300


def test_the_python_of_the_page_runs(capsys: pytest.CaptureFixture[str]) -> None:
    page = (Path(__file__).parents[2] / "docs" / "simulator.md").read_text()
    (code,) = (block for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "Radio" in block)
    exec(compile(code, "simulator.md", "exec"), {})
    # One of ten is lost, as 1/16 may be; five of them have left after 0.6 s.
    assert capsys.readouterr().out.splitlines()[0] == "4 5"


def test_what_no_radio_can_be_is_refused() -> None:
    with pytest.raises(InputError, match="range_m 0"):
        RadioSettings(range_m=0.0)
    with pytest.raises(InputError, match="frame_bytes 12"):
        RadioSettings(frame_bytes=12)
    with pytest.raises(InputError, match="finite"):
        Radio().link("r", (0.0, inf, 0.0))
    with pytest.raises(InputError, match="no node 'r'"):
        Radio().move("r", HERE, 0)
    radio = Radio(replace(CALM, faults=Faults(cuts=(Cut(0.0),))))
    radio.advance(5)
    with pytest.raises(InputError, match="4 after 5"):
        radio.advance(4)
