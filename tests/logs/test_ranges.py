"""Tables of ranges and poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from terrafuse.errors import LogError
from terrafuse.logs import open_log
from terrafuse.logs.base import Log, parse_source
from terrafuse.types import Scan

from .support import pose

HEADER = "stamp_s,x_m,y_m,yaw_rad,r0_m,r1_m,r2_m"


def write(folder: Path, *lines: str, name: str = "ring.csv") -> Path:
    path = folder / name
    path.write_text("\n".join(lines) + "\n")
    return path


def opened(path: Path, options: str = "") -> Log:
    return open_log(parse_source(f"{path}{options}", aimed=True))


def scans(path: Path, options: str = "") -> list[Scan]:
    return list(opened(path, options).scans())  # type: ignore[arg-type]


def refused(path: Path, *parts: str) -> None:
    with pytest.raises(LogError) as caught:
        scans(path)
    for part in parts:
        assert part in str(caught.value)


def test_a_line_is_a_scan(tmp_path: Path) -> None:
    path = write(
        tmp_path, "# of Tuesday", HEADER, "976052857.33753,1,2,0.5,1.5,inf,0.25", "", "976052858,1,3,0.5,nan,,2"
    )
    log = opened(path)
    first, second = scans(path)
    assert (log.reader, log.count) == ("ranges", 2)
    assert first.stamp_ns == 976052857337530000  # a float would be off by 60 ns
    assert np.allclose(first.T_world_sensor.matrix, pose(1, 2, 0, yaw=0.5).matrix)
    assert first.points.shape == (0, 3)
    assert first.readings.ranges_m.tolist() == [1.5, np.inf, 0.25]
    assert first.readings.directions is None
    assert np.isnan(second.readings.ranges_m).tolist() == [True, True, False]  # nothing is no reading


def test_units_stand_in_the_header_in_any_order(tmp_path: Path) -> None:
    """A quarter turn; 50 inch are 1.27 m; columns that nobody knows are not looked at."""
    header = "R1_in; note; r0_mm; yaw_deg; y_cm; x_mm; stamp_ns"
    (scan,) = scans(write(tmp_path, header, "50; hello; 840; 90; 25; 1500; 9007199254740993"))
    assert scan.stamp_ns == 9007199254740993  # no float holds it
    assert np.allclose(scan.readings.ranges_m, [0.84, 1.27])
    assert np.allclose(scan.T_world_sensor.matrix, pose(1.5, 0.25, yaw=np.pi / 2).matrix)


@pytest.mark.parametrize(
    ("header", "says"),
    [
        ("stamp,x_m,y_m,yaw_rad,r0_m", ":1: column 'stamp' has no unit; name it stamp_s or stamp_ns"),
        ("stamp_s,x_m,y_m,yaw_turns,r0_m", ":1: column 'yaw_turns' has a unit turns; name it yaw_rad or yaw_deg"),
        ("stamp_s,y_m,yaw_rad,r0_m", ":1: no column x_m or x_cm or x_mm or x_in; it has stamp_s, y_m, yaw_rad, r0_m"),
        ("stamp_s,x_m,y_m,yaw_rad,r0_m,r2_m", ":1: no column r1_m or"),
        ("stamp_s,x_m,y_m,yaw_rad,r0_m,r0_mm", ":1: columns r0_m, r0_mm are one and the same; keep one"),
    ],
)
def test_headers_that_lack_something(tmp_path: Path, header: str, says: str) -> None:
    path = write(tmp_path, header, "1,2,3,4,5")
    refused(path, f"{path}{says}")


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("1,2,3,4,5,6", ":4: 6 values, the header has 7"),
        ("soon,2,3,4,5,6,7", ":4: stamp_s: 'soon' is not a number of seconds"),
        ("1,2,3,4,5,six,7", ":4: r1_m is 'six', no number"),
        ("1,2,,4,5,6,7", ":4: y_m is '', no number"),
        ("1,2,3,nan,5,6,7", ":4: the pose x_m 2, y_m 3, yaw_rad nan is not finite"),
    ],
)
def test_a_broken_line_is_named(tmp_path: Path, line: str, says: str) -> None:
    path = write(tmp_path, HEADER, "1,2,3,4,5,6,7", "# a comment counts as a line", line)
    refused(path, f"{path}{says}")


def test_nothing_says_where_the_beams_look(tmp_path: Path) -> None:
    path = write(tmp_path, HEADER, "1,2,3,4,5,6,7")
    with pytest.raises(LogError, match=r"3 ranges a line, and nothing says where they look: describe the sensor .*--s"):
        open_log(str(path))


def test_other_tables_are_not_these(tmp_path: Path) -> None:
    """Points stay the `clouds` reader's; S1,…,S24 without poses is a known data set, and no log."""
    points = write(tmp_path, "x,y,z", "1,2,3", name="points.csv")
    assert open_log(f"{points}?poses=identity").reader == "clouds"
    for text in ("S1,S2,OUTPUT", "", "1,2,3"):
        path = write(tmp_path, text, "0.4,0.5,Move-Forward", name="other.csv")
        with pytest.raises(LogError):
            open_log(str(path))
    path = write(tmp_path, "S1,S2,OUTPUT", "0.4,0.5,Move-Forward", name="scitos.data")
    with pytest.raises(LogError, match=r"scitos\.data:1: no column stamp_s or stamp_ns; it has s1, s2, output"):
        open_log(f"{path}?reader=ranges")
