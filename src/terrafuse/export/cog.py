"""The map as one Cloud Optimized GeoTIFF: a band a layer, float32, NaN where unknown, overviews inside.

float32 keeps 0.06 mm of a height of 1000 m and every count up to 16.7 million; only stamps need an offset. They count
seconds from midnight UTC before the newest one: 8 ms a step within that day. The band's offset, which GIS tools add by
themselves, makes them seconds since 1970 again; its tag `epoch` says the same in words.

Overviews are averages of the known cells. That is unbiased and stays within the surface, where nearest neighbours keep
one cell of many and lose most of what a sparse scan saw, and cubic or bilinear kernels overshoot at walls and let NaN
grow. Of `state` it makes the share of vertical cells (1.3: 30 %), of counts the mean count.

zstd without a predictor is smallest on maps with gaps (3.9 MB for six KITTI scans; 4.8 MB with the integer and 5.2 MB
with the floating-point predictor), and level 6 is 1 % off level 9 in less time.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from terrafuse import __version__, crs, views
from terrafuse.errors import InputError, MissingExtra
from terrafuse.export.files import final
from terrafuse.models.base import Layer
from terrafuse.replica import Replica
from terrafuse.types import Array, Bounds

BLOCK = 512
CACHE_BYTES = 256 * 2**20
DAY_S = 86_400
MAX_CELLS = 3 * 10**8
"""A larger raster takes hours and gigabytes; most often cells are too fine for the log, or points lie far off."""

COG = {
    "driver": "COG",
    "blocksize": BLOCK,
    "compress": "ZSTD",
    "level": 6,
    "predictor": "NO",
    "overview_resampling": "AVERAGE",
    "bigtiff": "IF_SAFER",
    "num_threads": "ALL_CPUS",
}


def write_cog(
    replica: Replica,
    path: Path | str,
    layers: Sequence[str] | None = None,
    bounds: Bounds | None = None,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Write the layers (all by default) over the bounds (all that is known); `progress` is told the share done, 0 to 1.

    Memory is that of a few tiles; the folder of `path` needs room for the raster uncompressed, 4 bytes a cell and
    layer that lies in a known tile. Raises InputError for an empty map, OutputError where the file can't be written.
    """
    try:
        import rasterio
    except ImportError as error:
        raise MissingExtra("a GeoTIFF", "rasterio", "gis") from error
    chosen = views.chosen_layers(replica, layers)
    window = views.window_of(replica, bounds)
    height, width = views.shape_of(window)
    if height * width > MAX_CELLS:
        raise InputError(
            f"a raster of {width}×{height} cells is too large; use coarser cells (--resolution), "
            "drop stray points (--max-range), or export a part (--bounds)"
        )
    report = progress or (lambda _: None)
    with final(path) as temporary, rasterio.Env(GDAL_CACHEMAX=CACHE_BYTES):
        tiles = temporary.with_suffix(".tiles")
        written = _write_tiles(replica, tiles, chosen, window, report)
        _copy(tiles, temporary)
        _check(temporary, written)
        report(1.0)


def _write_tiles(
    replica: Replica, path: Path, layers: Sequence[Layer], window: views.CellWindow, progress: Callable[[float], None]
) -> list[tuple[Any, int]]:
    """A plain GeoTIFF, filled tile by tile in any order: a COG can only be made from a finished raster.

    Returns (rasterio window, checksum) of each tile.
    """
    import rasterio
    from rasterio.windows import Window

    height = views.shape_of(window)[0]
    offsets = [float(_midnight_s(replica)) if layer.name == "stamp" else 0.0 for layer in layers]
    shift = np.array(offsets)[:, None, None]
    count = len(views.keys_in(replica, window))
    written = []
    with rasterio.open(path, "w", **_profile(replica, layers, window)) as raster:
        _describe(raster, layers, offsets)
        for rows, columns, values in views.parts(replica, layers, window):
            stack = (np.stack([values[layer.name][::-1] for layer in layers]) - shift).astype(np.float32)
            part = Window(columns.start, height - rows.stop, stack.shape[2], stack.shape[1])
            raster.write(stack, window=part)
            written.append((part, _checksum(stack)))
            progress(0.8 * len(written) / count)
    return written


def _checksum(stack: Array) -> int:
    """Of values; one NaN is as good as another."""
    return zlib.crc32(np.nan_to_num(stack, nan=-1e30).tobytes())


def _profile(replica: Replica, layers: Sequence[Layer], window: views.CellWindow) -> dict[str, Any]:
    from rasterio import Affine
    from rasterio.crs import CRS

    height, width = views.shape_of(window)
    bounds, r = views.bounds_of(replica, window), replica.lattice.resolution_m
    name = replica.lattice.crs
    return {
        "driver": "GTiff",
        "width": width,
        "height": height,
        "count": len(layers),
        "dtype": "float32",
        "nodata": float("nan"),
        "crs": None if name is None else CRS.from_wkt(crs.parse(name).to_wkt()),
        "transform": Affine(r, 0.0, bounds.west, 0.0, -r, bounds.north),
        "tiled": True,
        "blockxsize": BLOCK,
        "blockysize": BLOCK,
        "interleave": "band",
        "sparse_ok": True,
        "bigtiff": "YES",
    }


def _describe(raster: Any, layers: Sequence[Layer], offsets: Sequence[float]) -> None:
    raster.update_tags(TIFFTAG_SOFTWARE=f"terrafuse {__version__}")
    raster.offsets = offsets
    for band, (layer, offset) in enumerate(zip(layers, offsets, strict=True), 1):
        raster.set_band_description(band, layer.name)
        raster.set_band_unit(band, layer.unit)
        raster.update_tags(band, long_name=layer.description)
        if layer.name == "stamp":
            raster.update_tags(band, epoch=datetime.fromtimestamp(offset, UTC).isoformat().replace("+00:00", "Z"))


def _midnight_s(replica: Replica) -> int:
    """The midnight (UTC, seconds since 1970) before the newest scan of the map."""
    newest_ns = max((entry.stamp_ns for entry in replica.store.history()), default=0)
    return newest_ns // (DAY_S * 10**9) * DAY_S


def _copy(tiles: Path, path: Path) -> None:
    import rasterio.shutil

    try:
        rasterio.shutil.copy(tiles, path, **COG)
    except Exception as error:  # GDAL's own errors have no public base class, and are no OSErrors
        raise OSError(f"GDAL: {error}") from error


def _check(path: Path, written: Sequence[tuple[Any, int]]) -> None:
    """Read everything back. GDAL writes late, at closing, and does not say when that fails, as on a full disk."""
    import rasterio

    with rasterio.open(path) as raster:
        levels = len(raster.overviews(1))
        for part, checksum in written:
            if _checksum(raster.read(window=part)) != checksum:
                raise OSError("what was read back is not what was written; is the disk full?")
    for level in range(levels):
        with rasterio.open(path, overview_level=level) as overview:
            for _, block in overview.block_windows(1):
                overview.read(window=block)
