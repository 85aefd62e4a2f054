"""The two files of a ROS map: map.yaml and the image that it names."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from terrafuse.errors import InputError, MissingExtra
from terrafuse.rosmap.meaning import Meaning
from terrafuse.rosmap.types import Placement, RosMap
from terrafuse.types import Array

REQUIRED = ("image", "resolution", "origin", "occupied_thresh", "free_thresh", "negate")


def read_map(path: Path | str) -> RosMap:
    """The map of a YAML file. Raises InputError that names the file, what is wrong, and the remedy."""
    file = Path(path)
    about = _description(file)
    with _in_file(file):
        placement, meaning = _placement(about), _meaning(about)
    grey, opaque = read_image(_image_file(file, about))
    return RosMap(placement, meaning, grey, opaque)


@contextmanager
def _in_file(file: Path) -> Iterator[None]:
    """Complaints about values, with the file that has them."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{file}: {error}") from error


def _description(file: Path) -> dict[str, Any]:
    if not file.is_file():
        raise InputError(f"{file}: no such file; give the .yaml of a ROS map")
    try:
        about = yaml.safe_load(file.read_text())
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise InputError(f"{file}: is no YAML ({' '.join(str(error).split())}); give the .yaml of a ROS map") from error
    if not isinstance(about, dict):
        raise InputError(f"{file}: holds no 'key: value' lines; give the .yaml of a ROS map")
    for key in REQUIRED:
        if about.get(key) is None:
            raise InputError(f"{file}: has no '{key}:', which map_server needs; add it")
    return about


def _placement(about: Mapping[str, Any]) -> Placement:
    origin = about["origin"]
    if not isinstance(origin, list) or len(origin) != 3:
        raise InputError(f"origin {origin!r}: give [x, y, yaw]")
    x, y, yaw = (_number("origin", value) for value in origin)
    return Placement(_number("resolution", about["resolution"]), x, y, yaw)


def _meaning(about: Mapping[str, Any]) -> Meaning:
    return Meaning(
        str(about.get("mode", "trinary")),
        _number("occupied_thresh", about["occupied_thresh"]),
        _number("free_thresh", about["free_thresh"]),
        _truth("negate", about["negate"]),
    )


def _number(key: str, value: Any) -> float:
    try:
        return float(value)  # YAML 1.1 takes 1e-2 for text
    except (TypeError, ValueError) as error:
        raise InputError(f"{key} {value!r}: give a number") from error


def _truth(key: str, value: Any) -> bool:
    if value not in (0, 1):
        raise InputError(f"{key} {value!r}: give 0 or 1")
    return bool(value)


def _image_file(file: Path, about: Mapping[str, Any]) -> Path:
    image = file.parent / str(about["image"])
    if not image.is_file():
        raise InputError(f"{file}: its image {image} is not there; put it there, or correct 'image:'")
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
        with Image.open(file) as image:
            image.load()
            return _channels(image)
    except UnidentifiedImageError as error:
        raise InputError(f"{file}: is no image; ROS maps have PGM, PNG or BMP") from error
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
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
        f"image: {yaml.safe_dump(image_name, allow_unicode=True).splitlines()[0]}\n"
        f"mode: {meaning.mode}\n"
        f"resolution: {_text(place.resolution_m)}\n"
        f"origin: [{_text(place.east_m)}, {_text(place.north_m)}, {_text(place.yaw_rad)}]\n"
        f"negate: {int(meaning.negate)}\n"
        f"occupied_thresh: {_text(meaning.occupied_thresh)}\n"
        f"free_thresh: {_text(meaning.free_thresh)}\n"
    )


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
