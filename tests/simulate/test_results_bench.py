"""The page of results: scenarios' parts are replaced one by one, pictures are small."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

Image = pytest.importorskip("PIL.Image")
pytest.importorskip("embreex")

from bench import results  # noqa: E402


def test_parts_are_replaced_one_by_one_and_keep_their_order(tmp_path: Path) -> None:
    page = tmp_path / "results.md"
    for name, text in (
        ("mine", "## Mine\n"),
        ("hallway", "## Hall\n"),
        ("village", "## Old\n"),
        ("village", "## New\n"),
    ):
        results.put(page, name, text)
    text = page.read_text()
    assert text.startswith("# Results\n")
    assert [line for line in text.splitlines() if line.startswith("## ")] == ["## New", "## Hall", "## Mine"]
    results.put(page, "mine", "## Mine\n")
    assert page.read_text() == text


def test_pictures_become_small_enough(tmp_path: Path) -> None:
    """Noise of 1.2 million pixels is the worst there is: smaller, and of the film every other frame, or fewer."""
    rng = np.random.default_rng(0)
    noise = [Image.fromarray(rng.integers(0, 255, (400, 600, 3), np.uint8)) for _ in range(5)]
    noise[0].save(tmp_path / "film.gif", save_all=True, append_images=noise[1:], duration=100)
    Image.fromarray(rng.integers(0, 255, (1000, 1200, 3), np.uint8)).save(tmp_path / "picture.png")
    for file in ("film.gif", "picture.png"):
        results.shrink(tmp_path / file, tmp_path / f"small-{file}")
        assert (tmp_path / f"small-{file}").stat().st_size <= results.MOST_BYTES
    with Image.open(tmp_path / "small-film.gif") as film:
        assert film.n_frames > 1


def test_a_small_picture_keeps_its_size(tmp_path: Path) -> None:
    Image.new("RGB", (300, 200), "#e6007e").save(tmp_path / "a.png")
    results.shrink(tmp_path / "a.png", tmp_path / "b.png")
    with Image.open(tmp_path / "b.png") as picture:
        assert picture.size == (300, 200)
        assert picture.convert("RGB").getpixel((0, 0)) == (230, 0, 126)
