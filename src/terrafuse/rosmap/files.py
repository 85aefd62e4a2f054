"""The two files of a ROS map: map.yaml and the image that it names."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from terrafuse import strict_yaml
from terrafuse.errors import InputError, MissingExtra, TerrafuseError, shown
from terrafuse.rosmap.meaning import Meaning
from terrafuse.rosmap.types import Placement, RosMap
from terrafuse.strict_yaml import Document
from terrafuse.types import Array

PLAIN_NAME = re.compile(r"[A-Za-z][\w.\-/]*\.[A-Za-z]\w*")
REQUIRED = ("image", "resolution", "origin", "occupied_thresh", "free_thresh", "negate")


def read_map(path: Path | str) -> RosMap:
    """The map of a YAML file. Raises InputError that names the file, what is wrong, and the remedy."""
    file = Path(path)
    about = _description(file)
    placement, meaning = _placement(about), _meaning(about)
    grey, opaque = read_image(_image_file(file, about))
    return RosMap(placement, meaning, grey, opaque)


def _description(file: Path) -> Document:
    try:
        about = strict_yaml.load(file)
    except InputError as error:
        raise InputError(f"{str(error).removesuffix('; give a YAML file')}; give the .yaml of a ROS map") from error
    if not isinstance(about.value, dict):
        raise InputError(f"{file}: holds no 'key: value' lines; give the .yaml of a ROS map")
    for key in REQUIRED:
        if about.value.get(key) is None:
            raise InputError(f"{file}: has no '{key}:', which map_server needs; add it")
    return about


@contextmanager
def _at(about: Document, key: str) -> Iterator[None]:
    """Complaints about the value of a key, with file and line."""
    try:
        yield
    except InputError as error:
        raise about.error([key], str(error)) from error


def _placement(about: Document) -> Placement:
    origin = about.value["origin"]
    if not isinstance(origin, list) or len(origin) != 3:
        raise about.error(["origin"], f"origin {shown(repr(origin))}: give [x, y, yaw]")
    resolution_m = _number(about, "resolution")
    with _at(about, "resolution"):
        Placement(resolution_m)
    with _at(about, "origin"):
        return Placement(resolution_m, *(_number(about, "origin", k) for k in range(3)))


def _meaning(about: Document) -> Meaning:
    mode, negate = about.value.get("mode", "trinary"), about.value["negate"]
    with _at(about, "mode"):
        Meaning(mode if isinstance(mode, str) else repr(mode))
    if negate not in (0, 1):
        raise about.error(["negate"], f"negate {shown(repr(negate))}: give 0 or 1")
    occupied, free = _number(about, "occupied_thresh"), _number(about, "free_thresh")
    with _at(about, "occupied_thresh"):
        return Meaning(mode, occupied, free, bool(negate))


def _number(about: Document, *path: str | int) -> float:
    value = about.value[path[0]] if len(path) == 1 else about.value[path[0]][path[1]]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise about.error(path, f"{path[0]} {shown(repr(value))}: give a number")
    return float(value)


def _image_file(file: Path, about: Document) -> Path:
    name = about.value["image"]
    if not isinstance(name, str):
        raise about.error(["image"], f"image {shown(repr(name))}: give the name of a file, in quotes")
    image = file.parent / name
    try:
        there = image.is_file()
    except OSError:  # too long a name
        there = False
    if not there:
        raise about.error(["image"], f"its image {shown(name)} is not there; put it there, or correct 'image:'")
    return image


def read_image(file: Path) -> tuple[Array, Array | None]:
    """(grey, opaque) of an image: PGM (binary or plain), PNG, BMP or whatever else Pillow reads.

    Colours are averaged, as map_server does; 16 bits are scaled to 0 to 255.
    """
    try:
        from PIL import Image, UnidentifiedImageError
    except ImportError as error:
        raise MissingExtra("a map image", "pillow", "plot") from error
    try:
        with warnings.catch_warnings(), Image.open(file) as image:
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # of those that it still takes
            image.load()
            return _channels(image)
    except TerrafuseError:
        raise
    except UnidentifiedImageError as error:
        raise InputError(f"{file}: is no image; ROS maps have PGM, PNG or BMP") from error
    except Exception as error:  # a decoder of Pillow's raises whatever damaged bytes lead it to
        raise InputError(f"{file}: can't be read ({error}); is it whole? Save the map again") from error


def _channels(image: Any) -> tuple[Array, Array | None]:
    if image.mode == "L" and "transparency" not in image.info:
        return np.asarray(image), None
    if image.mode.startswith("I"):
        return np.asarray(image, np.float64) * (255 / 65535), None
    if image.mode == "F":
        raise InputError(f"{image.filename}: holds floating-point numbers; ROS maps have 8 bits a pixel")
    alpha = image.mode in ("LA", "PA", "RGBA") or "transparency" in image.info
    colours = np.asarray(image.convert("RGBA" if alpha else "RGB"))
    grey = colours[..., :3].mean(axis=2)
    whole = grey.astype(np.uint8)
    opaque = colours[..., 3] == 255 if alpha else None
    return (whole if (whole == grey).all() else grey), None if opaque is None or opaque.all() else opaque


def write_map(ros_map: RosMap, yaml_file: Path, image_file: Path, image_name: str) -> None:
    """Write both files; the YAML names the image `image_name`. `grey` must be uint8."""
    WRITERS[Path(image_name).suffix.lower()](image_file, ros_map.grey, ros_map.opaque)
    yaml_file.write_text(description(ros_map, image_name))


def image_suffix(ros_map: RosMap) -> str:
    """`.pgm`, or `.png` where some pixels are transparent."""
    return ".pgm" if ros_map.opaque is None else ".png"


def description(ros_map: RosMap, image_name: str) -> str:
    """The YAML's text; floats in the shortest form that reads back as they are."""
    place, meaning = ros_map.placement, ros_map.meaning
    return (
        f"{image_line(image_name)}"
        f"mode: {meaning.mode}\n"
        f"resolution: {_text(place.resolution_m)}\n"
        f"origin: [{_text(place.east_m)}, {_text(place.north_m)}, {_text(place.yaw_rad)}]\n"
        f"negate: {int(meaning.negate)}\n"
        f"occupied_thresh: {_text(meaning.occupied_thresh)}\n"
        f"free_thresh: {_text(meaning.free_thresh)}\n"
    )


def image_line(name: str) -> str:
    """The YAML's line for the image; plain where readers of YAML 1.1 and 1.2 take that for the same text."""
    if PLAIN_NAME.fullmatch(name):
        return f"image: {name}\n"
    quoted = yaml.safe_dump(name, default_style='"', allow_unicode=True, width=math.inf)
    return f"image: {quoted}"


def _text(value: float) -> str:
    """YAML 1.1 takes 1e-05 for text, so no exponents."""
    return np.format_float_positional(value, trim="0")


def _write_pgm(file: Path, grey: Array, _: Array | None) -> None:
    rows, columns = grey.shape
    file.write_bytes(b"P5\n%d %d\n255\n" % (columns, rows) + np.ascontiguousarray(grey).tobytes())


def _write_png(file: Path, grey: Array, opaque: Array | None) -> None:
    """As RGBA, because GraphicsMagick, with which map_server reads, has trouble with grey and alpha."""
    try:
        from PIL import Image
    except ImportError as error:
        raise MissingExtra("a map image with transparent pixels", "pillow", "plot") from error
    alpha = np.full(grey.shape, 255, np.uint8) if opaque is None else np.where(opaque, 255, 0).astype(np.uint8)
    Image.fromarray(np.stack([grey, grey, grey, alpha], axis=2)).save(file, "PNG")


WRITERS: dict[str, Callable[[Path, Array, Array | None], None]] = {".pgm": _write_pgm, ".png": _write_png}
