"""Robots as people describe them."""

from __future__ import annotations

from dataclasses import FrozenInstanceError
from pathlib import Path

import pytest

from terrafuse.errors import InputError
from terrafuse.navigate import Robot, load_robot
from terrafuse.navigate.robot import read_robot

WHOLE = """
# a Summit-XL
radius_m: 0.5
unknown: forbid
max_slope: 0.3
occupied_from: 0.6
keep_away_m: 1
keep_away_price: 3.5
occupied_price: 0
unknown_price: 10
"""


def test_a_file_is_a_robot(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(WHOLE)
    robot = load_robot(file)
    assert robot == Robot(0.5, "forbid", 0.3, 0.6, 1.0, 3.5, 0.0, 10.0)
    with pytest.raises(FrozenInstanceError):
        robot.radius_m = 1.0  # type: ignore[misc]


def test_what_is_left_out_is_the_default() -> None:
    assert read_robot("", "x") == Robot()
    assert read_robot("radius_m: 1\nmax_slope: null", "x") == Robot(radius_m=1.0)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("unknown: free\nradius_m: -1", "r.yaml:2: radius_m = -1: input should be greater than or equal to 0"),
        ("radius_m: '1'", "r.yaml:1: radius_m = '1': input should be a valid number"),
        ("radius_m: true", "radius_m = True: input should be a valid number"),
        ("radius_m: .nan", "radius_m = nan: input should be a finite number"),
        ("radius_m:", "radius_m = None: input should be a valid number"),
        ("unknown: maybe", "unknown = 'maybe': input should be 'avoid', 'forbid' or 'free'"),
        ("max_slope: 0", "max_slope = 0: input should be greater than 0"),
        ("unknown_price: 0.5", "unknown_price = 0.5: input should be greater than or equal to 1"),
        ("radius: 1", "r.yaml:1: there is no key 'radius'; known here: radius_m, unknown"),
        ("7: 1", "there is no key '7'"),
        ("radius_m: 1\nradius_m: 2", "r.yaml:2: 'radius_m' is given twice"),
        ("- radius_m", "r.yaml: holds no keys"),
        ("radius_m: [", "not YAML"),
        ("[1]: 2", "r.yaml:1: not a key"),
        ("radius_m: 2001-99-99", "r.yaml:1: radius_m = '2001-99-99': input should be a valid number"),
        ("\nradius_m: [1, [2]]", "r.yaml:2: radius_m = [1, [2]]: input should be a valid number"),
        ("radius_m: " + "[" * 5000, "r.yaml:1: nests deeper than"),
        ("radius_m: " + "9" * 400, "r.yaml:1: 9999"),
        ("1e1: 1", "r.yaml:1: there is no key '10.0'"),
    ],
)
def test_complaints_name_line_key_and_remedy(text: str, complaint: str) -> None:
    with pytest.raises(InputError) as raised:
        read_robot(text, "r.yaml")
    assert complaint in str(raised.value)


def test_a_file_that_is_none(tmp_path: Path) -> None:
    binary = tmp_path / "robot.yaml"
    binary.write_bytes(b"\xff\xfe\x00")
    for file in (tmp_path / "none.yaml", tmp_path, binary):
        with pytest.raises(InputError, match="can't be read"):
            load_robot(file)
