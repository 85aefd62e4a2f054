"""What docs/simulator.md shows of worlds and sensors is so."""

from __future__ import annotations

import re
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from terrafuse.simulate import WORLDS
from terrafuse.simulate.motion import BODIES
from terrafuse.simulate.movers import SHAPES
from terrafuse.simulate.sensors.codes import arrivals, let_through, overlap_sums, walsh_hadamard

PAGE = (Path(__file__).parents[2] / "docs" / "simulator.md").read_text()
H = walsh_hadamard()


def test_the_first_example_runs(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("embreex")
    code = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)[0]
    exec(compile(code, "simulator.md", "exec"), {})
    said = capsys.readouterr().out.split()
    assert said[1:3] == ["(600,", "600)"]
    assert int(said[0]) > 30
    assert float(said[3]) > 3000


def test_it_names_every_world() -> None:
    for name in WORLDS:
        assert f"`{name}(" in PAGE, name


def test_robots_are_as_large_as_their_bodies_move() -> None:
    for name, moves in BODIES.items():
        (part,) = SHAPES[name]
        reach = part.length_m / 2 if part.round else np.hypot(part.length_m, part.width_m) / 2
        assert reach == pytest.approx(moves.radius_m, abs=0.005), name


def test_the_codes_that_overlap_are_those_it_names() -> None:
    most = {(a, b): abs(overlap_sums(H[a], H[b])).max() for a, b in combinations(range(8), 2)}
    assert {pair: m * 8 for pair, m in most.items() if m > 0.5} == {(2, 3): 7, (4, 6): 6, (5, 7): 6, (6, 7): 5}
    assert all(most[pair] <= 0.5 for pair in combinations((0, 1, 2, 4, 7), 2))


def test_as_many_get_through_as_the_table_says() -> None:
    rng = np.random.default_rng(0)
    through = {"slots": [], "sliding": []}  # type: dict[str, list[float]]
    own = []
    for a in range(8):
        for b in range(8):
            heard = arrivals(np.tile(H[b], (300, 1)), rng.uniform(0, 800, 300))
            if a == b:
                own.append(let_through("slots", H[a], heard).mean())
                assert let_through("sliding", H[a], heard).all()
            else:
                for receiver, shares in through.items():
                    shares.append(float(let_through(receiver, H[a], heard).mean()))
    assert np.mean(through["slots"]) == pytest.approx(0.03, abs=0.005)
    assert max(through["slots"]) == pytest.approx(0.33, abs=0.08)
    assert np.mean(through["sliding"]) == pytest.approx(8 / 56)
    assert min(own) == pytest.approx(0.09, abs=0.05)
