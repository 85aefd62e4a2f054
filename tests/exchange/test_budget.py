"""The budget: how many bytes leave in any two seconds, who waits for how long, and what goes first."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.exchange.budget import Budget
from terrafuse.exchange.courier import Channel, Courier, CourierSettings
from terrafuse.exchange.links import Frame, Link, MemoryHub
from terrafuse.exchange.outbox import POST, Outbox
from terrafuse.lattice import Lattice
from terrafuse.mapper import Mapper
from terrafuse.models import make_model
from terrafuse.replica import Replica
from terrafuse.testing.deltas import random_scans

TICK_NS = 50_000_000
SECOND_NS = 1_000_000_000
LATTICE = Lattice(0.2, 10.0)
MODEL = make_model("elevation")
OVERHEAD = 40


class Scale:
    """A link that writes down when how many bytes left, the carrier's own included."""

    def __init__(self, link: Link) -> None:
        self.node, self.max_frame_bytes = link.node, link.max_frame_bytes
        self.listen, self.receive, self.close = link.listen, link.receive, link.close
        self.sent: list[tuple[int, int, str]] = []
        self._link = link

    def send(self, topic: str, payload: bytes, now_ns: int) -> None:
        self.sent.append((now_ns, len(payload) + OVERHEAD, topic.split("/")[0]))
        self._link.send(topic, payload, now_ns)


def robot_and_station(bytes_per_s: float, post_every_ns: int | None = None) -> tuple[Scale, list[float]]:
    """A robot that maps more than it can tell, for 40 s; how long its posts took, s."""
    hub = MemoryHub(1400)
    scale = Scale(hub.link("r1"))
    mapper = Mapper("r1", LATTICE, MODEL)
    settings = CourierSettings(bytes_per_s=bytes_per_s, overhead_bytes=OVERHEAD)
    late_s: list[float] = []
    now_ns = 0

    def heard(sender: str, kind: str, payload: bytes) -> None:
        late_s.append((now_ns - int(payload)) / 1e9)

    robot = Courier(scale, [Channel("fine", own=mapper)], peers=["station"], settings=settings)
    station = Courier(hub.link("station"), [Channel("fine", Replica(LATTICE, MODEL).store)], on_message=heard)
    scans = random_scans(1, 40, 60.0, 20_000)
    for now_ns in range(0, 40 * SECOND_NS, TICK_NS):
        if now_ns % SECOND_NS == 0:
            mapper.integrate(scans[now_ns // SECOND_NS])
        if post_every_ns and now_ns % post_every_ns == 0:
            robot.post("station", f"pose {now_ns}", str(now_ns).encode())
        robot.tick(now_ns)
        station.tick(now_ns)
    assert robot.behind("station")
    return scale, late_s


def test_any_two_seconds_take_the_budget_within_a_twentieth() -> None:
    """As long as there is something to send, which is from the second second on; at 20 kB/s, in frames of 1 kB."""
    scale, _ = robot_and_station(20_000.0)
    at_ns = np.array([when for when, _, _ in scale.sent])
    total = np.concatenate([[0], np.cumsum([size for _, size, _ in scale.sent])])
    begins = np.arange(2 * SECOND_NS, 38 * SECOND_NS, TICK_NS // 2)
    inside = total[np.searchsorted(at_ns, begins + 2 * SECOND_NS)] - total[np.searchsorted(at_ns, begins)]
    assert inside.max() <= 1.05 * 40_000
    assert inside.min() >= 0.95 * 40_000


@pytest.mark.parametrize("bytes_per_s", [2_000.0, 20_000.0])
def test_posts_are_never_half_a_second_late(bytes_per_s: float) -> None:
    scale, late_s = robot_and_station(bytes_per_s, post_every_ns=500_000_000)
    assert len(late_s) >= 75
    assert max(late_s) < 0.5
    kinds = Counter[str]()
    for _, size, kind in scale.sent:
        kinds[kind] += size
    assert kinds["delta"] > 0.6 * sum(kinds.values())


@given(sizes=st.lists(st.integers(1, 1500), max_size=60), steps_ms=st.lists(st.integers(1, 400), max_size=60),
       bytes_per_s=st.sampled_from([1e3, 2e4, 1e6]))  # fmt: skip
def test_no_window_has_more_than_it_earned(sizes: list[int], steps_ms: list[int], bytes_per_s: float) -> None:
    """Whatever is sent when: over a time, at most what that earns, what was saved up, a step's worth, and a frame."""
    budget, now_ns, sent = Budget(bytes_per_s, 0), 0, []
    waiting = list(sizes)
    for step_ms in steps_ms:
        now_ns += step_ms * 1_000_000
        budget.earn(now_ns)
        while waiting and budget.left:
            sent.append((now_ns, budget.pay(waiting.pop())))
    for k, (begin_ns, _) in enumerate(sent):
        for end_ns, _ in sent[k:]:
            size = sum(size for at_ns, size in sent if begin_ns <= at_ns <= end_ns)
            assert size <= bytes_per_s * ((end_ns - begin_ns) / 1e9 + 0.4) + 1500
            if end_ns - begin_ns < 2 * SECOND_NS:
                assert size <= 1.02 * 2 * bytes_per_s + 1500


def test_the_two_seconds_after_a_nap_have_no_more_than_others() -> None:
    """Half a second's worth at once and 39 steps' would be 2.45 s' worth; it is 102 % of two seconds', and a frame."""
    budget, paid = Budget(1000.0, 0), 0
    budget.earn(0)
    for step in range(40):
        budget.earn(500_000_000 + step * 50_000_000)
        while budget.left:
            paid += budget.pay(10)
    assert 2000 <= paid <= 2050


def test_who_slept_does_not_make_up_for_it() -> None:
    budget = Budget(1000.0, 10)
    budget.earn(0)
    budget.earn(60 * SECOND_NS)
    paid = 0
    while budget.left:
        paid += budget.pay(90)
    assert paid == 500  # half a second's worth, in frames of 90 and 10


def test_frames_are_short_where_the_budget_is_thin() -> None:
    # A twentieth of a second: 1000 of 20,000; 40 of them are the carrier's.
    assert [Budget(rate, 40).frame_bytes(1400) for rate in (1e3, 2e4, 1e6, float("inf"))] == [256, 960, 1400, 1400]


# --- lanes -----------------------------------------------------------------------------------------------------------


class Lines:
    """A link that only writes down."""

    node, max_frame_bytes = "r1", 1000

    def __init__(self) -> None:
        self.sent: list[Frame] = []

    def send(self, topic: str, payload: bytes, now_ns: int) -> None:
        self.sent.append(Frame(topic, payload))


def test_posts_first_then_the_channels_and_the_last_has_its_share() -> None:
    lines = Lines()
    outbox = Outbox(lines, Budget(float("inf"), 0), ["coarse", "fine"], Counter())  # type: ignore[arg-type]
    left = {"coarse": 16, "fine": 16}

    def refill(lane: str) -> bool:
        left[lane] -= 1
        if left[lane] >= 0:
            outbox.put(outbox.message(f"delta/{lane}", bytes([left[lane]])), lane)
        return left[lane] >= 0

    for lane in left:
        outbox.fill(lane, lambda lane=lane: refill(lane))  # type: ignore[misc]
    outbox.put(outbox.message("post/x/r1", b"now"), POST)
    outbox.send(0)
    assert lines.sent[0].topic == "post/x/r1"
    order = "".join(frame.topic[6] for frame in lines.sent[1:])
    assert order[:17] == "cccccccfcccccccfc"  # each eighth of the last lane that has any
    assert Counter(order) == {"c": 16, "f": 16}


def test_what_waits_is_made_when_it_can_go() -> None:
    """With room for one frame, one message is made."""
    lines, made = Lines(), []
    outbox = Outbox(lines, Budget(1000.0, 0), ["fine"], Counter())  # type: ignore[arg-type]

    def refill() -> bool:
        made.append(outbox.message("delta/fine", bytes([len(made)] * 100)))
        outbox.put(made[-1], "fine")
        return True

    outbox.fill("fine", refill)
    outbox.send(0)
    assert (len(lines.sent), len(made)) == (1, 1)


def test_a_long_post_leaves_room_for_summaries() -> None:
    """20 kB at 2 kB/s would silence a node for ten seconds."""
    hub = MemoryHub(1400)
    scale = Scale(hub.link("r1"))
    node = Courier(scale, [], settings=CourierSettings(bytes_per_s=2000, overhead_bytes=OVERHEAD))
    other = Courier(hub.link("station"), [], settings=CourierSettings())
    node.post("station", "order", bytes(np.random.default_rng(1).bytes(20_000)))
    for k in range(200):
        node.tick(k * TICK_NS)
        other.tick(k * TICK_NS)
    at_s = np.array([now_ns for now_ns, _, kind in scale.sent if kind == "summary"]) / SECOND_NS
    assert np.diff(at_s).max() < 3
    assert sum(kind == "post" for _, _, kind in scale.sent) > 20
