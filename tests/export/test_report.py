"""The report is one well-formed page that needs nothing else and believes nobody."""

from __future__ import annotations

import base64
import copy
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from terrafuse.errors import InputError
from terrafuse.export.report import write_report

EVIL = '<script>alert("1")</script>&amp;'
PNG = b"\x89PNG\r\n\x1a\nnot really"

REPORT: dict[str, Any] = {
    "terrafuse": "0.1.0",
    "map": {
        "model": "elevation",
        "settings": {"static": False, "variance_threshold_m2": 0.05},
        "resolution_m": 0.1,
        "tile_m": 40.0,
        "crs": "EPSG:32632",
        "digest": "ab" * 32,
    },
    "robots": {
        "alpha": {
            "log": "runs/alpha",
            "reader": "kitti",
            "scans": 6,
            "skipped": {"no pose": 2},
            "points": 745_236,
            "dropped": {"not finite": 12, "too far": 3},
            "seconds": {"observe": 0.021, "merge": 0.5},
            "scans_per_second": 88.12,
            "points_per_second": 11_234_567.0,
            "deltas": 3,
            "distance_m": 4.31,
            "loads": 7,
            "evictions": 5,
            "writes": 12,
            "most_resident": 9,
            "allocation": {
                "window_cells": 2_560_000,
                "allocated_cells": 640_000,
                "observed_of_window": 0.1191,
                "observed_of_allocated": 0.4766,
            },
        },
        EVIL: {"log": EVIL, "scans": 1, "dropped": {EVIL: 1}, "seconds": {EVIL: 1.0}},
    },
    "cells": 305_000,
    "tiles": 32,
    "bounds": [-78.3, -55.8, 82.3, 51.3],
    "resident_bytes": 213_000_000,
    "allocated_bytes": 31_000_000,
    "points_per_second": 19_000_000.0,
    "delta_bytes_per_robot": {"alpha": 1_200_034, EVIL: 10},
    "layers": {
        "height": {"unit": "m", "min": -3.123456, "mean": 0.1, "max": 8.2, "cells": 305_000},
        "stamp": {"unit": "s", "min": 1317000000.0, "mean": 1317000000.2, "max": 1317000000.5, "cells": 305_000},
        "none": {"unit": "1", "min": None, "mean": None, "max": None, "cells": 0},
    },
    "seconds": {"map": 0.1, "raster": 1.2},
    "settings": {"window": "tiles3x3", "note": EVIL, "origin_m": None, "model_settings": {"k": [1, 2]}},
    "files": {"raster": "map.tif"},
}


def page(folder: Path, report: dict[str, Any]) -> tuple[str, ElementTree.Element]:
    picture = folder / "map.png"
    picture.write_bytes(PNG)
    write_report(folder / "report.html", report, picture)
    text = (folder / "report.html").read_text(encoding="utf-8")
    assert text.startswith("<!DOCTYPE html>\n")
    return text, ElementTree.fromstring(text.removeprefix("<!DOCTYPE html>"))


def table(root: ElementTree.Element, title: str) -> list[list[str]]:
    (section,) = [part for part in root.iter("section") if part.findtext("h2") == title]
    return [["".join(cell.itertext()) for cell in row] for row in section.iter("tr")]


def test_everything_is_in_its_table(tmp_path: Path) -> None:
    _, root = page(tmp_path, REPORT)
    robots = table(root, "Robots")
    assert robots[1] == [
        "alpha",
        "runs/alpha kitti",
        "6",
        "745,236",
        "11,234,567",
        "88.12",
        "4.31 m",
        "3",
        "1.2 MB",
    ]
    windows = table(root, "Windows")
    assert windows[1] == ["alpha", "2,560,000", "11.9%", "640,000", "47.7%", "9", "7", "12", "5"]
    assert windows[2][1:] == [""] * 8
    assert robots[2][0] == EVIL
    assert ["alpha", "points dropped", "not finite", "12"] in table(root, "Points dropped, scans skipped")
    assert ["alpha", "scans skipped", "no pose", "2"] in table(root, "Points dropped, scans skipped")
    facts = dict(table(root, "Map"))
    assert facts["west, south, east, north"] == "-78.3, -55.8, 82.3, 51.3 m"
    assert facts["frame"] == "EPSG:32632"
    assert facts["SHA-256 of the cells"] == "ab" * 32
    assert facts["most memory of the process"] == "213 MB"
    assert table(root, "Layers")[1] == ["height", "m", "-3.1235", "0.1", "8.2", "305,000"]
    assert table(root, "Layers")[2][1:3] == ["UTC", "2011-09-26 01:20:00.000"]
    assert table(root, "Layers")[3] == ["none", "", "", "", "", "0"]
    assert table(root, "Seconds of each robot")[1] == ["alpha", "0.021", "0.500", ""]
    assert table(root, "Seconds of the run") == [["", "map", "raster"], ["run", "0.100", "1.200"]]
    settings = dict(table(root, "Settings"))
    assert settings["window"] == "tiles3x3"
    assert settings["variance_threshold_m2"] == "0.05"


def test_nothing_that_a_name_says_is_believed(tmp_path: Path) -> None:
    text, root = page(tmp_path, REPORT)
    assert EVIL in (root.findtext("head/title") or "")
    assert "<script" not in text.lower()
    assert {element.tag for element in root.iter()}.isdisjoint({"script", "link", "iframe", "a", "object"})


def test_it_needs_nothing_else(tmp_path: Path) -> None:
    text, root = page(tmp_path, REPORT)
    (image,) = root.iter("img")
    assert image.attrib["src"] == "data:image/png;base64," + base64.b64encode(PNG).decode()
    assert "http" not in text
    assert "url(" not in text
    assert "prefers-color-scheme: dark" in text


@pytest.mark.parametrize("key", [*REPORT, "everything"])
def test_missing_keys_are_left_out(key: str, tmp_path: Path) -> None:
    report = {} if key == "everything" else {name: value for name, value in REPORT.items() if name != key}
    page(tmp_path, report)


@pytest.mark.parametrize("key", REPORT["robots"]["alpha"])
def test_a_robot_may_lack_anything(key: str, tmp_path: Path) -> None:
    report = copy.deepcopy(REPORT)
    del report["robots"]["alpha"][key]
    page(tmp_path, report)


def test_an_empty_map_has_no_bounds(tmp_path: Path) -> None:
    _, root = page(tmp_path, {**REPORT, "bounds": None, "cells": 0})
    assert dict(table(root, "Map"))["west, south, east, north"] == "nothing known"


def test_a_picture_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no\.png.*picture can't be read"):
        write_report(tmp_path / "report.html", REPORT, tmp_path / "no.png")
    assert not (tmp_path / "report.html").exists()
