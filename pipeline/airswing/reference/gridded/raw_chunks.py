"""Values of stored chunks at some of their points, past the libraries that would make whole arrays.

A chunk of a NetCDF-4 variable or of a Zarr array is fetched as the octets it is stored in, expanded
once (of Blosc only the blocks that hold what is wanted), and only the wanted values are put
together from its planes of octets and unpacked: no array of the chunk is made, nothing is cast or
masked that is not asked for.

Assumptions and validity
------------------------
* NetCDF-4: no filter, deflate, or shuffle and deflate; read by h5py. Zarr (versions 2 and 3, local
  folders): regular chunks in C order, no filters, one compressor numcodecs knows. Whatever else
  there is (sharding, other filters, groups, a change of dtype by `_Unsigned`) is left to xarray:
  `raw_variable` gives None.
* A chunk that was never written is left to xarray, too: what it holds is each format's own matter.
* Unpacking is in double precision: value * scale_factor + add_offset.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Octets = NDArray[np.uint8]
# Octets (n, width) of n values, counted through the chunk that begins at a place; None where no
# chunk was written.
Fetch = Callable[[tuple[int, ...], Ints], "Octets | None"]


@dataclass(frozen=True)
class RawVariable:
    """A variable whose chunks are read as they are stored."""

    chunks: tuple[int, ...]
    dtype: np.dtype[np.generic]  # as stored
    fetch: Fetch
    scale: float
    offset: float
    fills: tuple[float, ...]  # stored values that are none

    def values(self, place: tuple[int, ...], flat: Ints) -> Floats | None:
        """Some values, counted through the chunk that begins at a place; None where not written.

        Raises
        ------
        ValueError
            The chunk is not of its length.
        """
        octets = self.fetch(place, flat)
        if octets is None:
            return None
        stored = np.ascontiguousarray(octets).view(self.dtype)[..., 0]
        found: Floats = stored.astype(np.float64)
        for fill in self.fills:
            found[stored == fill] = np.nan
        if self.scale != 1.0 or self.offset != 0.0:
            found = found * self.scale + self.offset
        return found


def raw_variable(ds: xr.Dataset, name: str, chunks: tuple[object, ...]) -> RawVariable | None:
    """A variable's chunks, of the lengths they are taken to have, where they can be read as stored.

    None where they must be left to xarray.
    """
    variable = ds.variables[name]
    source = str(variable.encoding.get("source") or ds.encoding.get("source") or "")
    known = variable.encoding.keys() | variable.attrs.keys()
    if variable.chunks is not None or not source or "_Unsigned" in known:
        return None
    if not all(isinstance(length, int) for length in chunks):
        return None
    path = Path(source.removeprefix("file://"))
    try:
        stored = _of_zarr(path, name) if path.is_dir() else _of_hdf5(path, name)
    except (OSError, KeyError, ValueError, ImportError):
        return None
    if stored is None or stored[0] != tuple(chunks) or stored[1].kind not in "iuf":
        return None
    length, dtype, fetch = stored
    encoding = variable.encoding
    # Only values that equal themselves are compared: NaN marks itself.
    fills = [encoding[key] for key in ("_FillValue", "missing_value") if key in encoding]
    return RawVariable(
        length,
        dtype,
        fetch,
        float(encoding.get("scale_factor", 1.0)),
        float(encoding.get("add_offset", 0.0)),
        tuple(float(value) for fill in fills for value in np.atleast_1d(fill) if value == value),
    )


# File of a chunk, and which of its values are wanted, to their octets (n, width).
_Expand = Callable[[io.FileIO, Ints], Octets]
_Stored = tuple[tuple[int, ...], "np.dtype[np.generic]", Fetch]
_Expanded = bytes | bytearray | memoryview


def _taken(
    octets: _Expanded, size: int, width: int, flat: Ints, *, shuffled: bool = False
) -> Octets:
    """Octets of some values of an expanded chunk.

    `shuffled`: the first octets of all values stand before the second ones, and so on.
    """
    plain = np.frombuffer(octets, dtype=np.uint8)
    if plain.size != size:
        raise ValueError(f"a chunk of {plain.size} octets")
    planes = plain.reshape(width, -1).T if shuffled else plain.reshape(-1, width)
    return planes[flat]


def _of_hdf5(path: Path, name: str) -> _Stored | None:
    import deflate
    import h5py

    with path.open("rb") as file:
        if file.read(4) != b"\x89HDF":
            return None
    opened = h5py.File(path, "r")
    data = opened[name]
    filters = data.id.get_create_plist()
    codes = [filters.get_filter(k)[0] for k in range(filters.get_nfilters())]
    if data.chunks is None or codes not in ([], [1], [2, 1]):
        return None
    width = data.dtype.itemsize
    size = int(np.prod(data.chunks)) * width

    def fetch(place: tuple[int, ...], flat: Ints) -> Octets | None:
        try:
            left_out, octets = data.id.read_direct_chunk(place)
        except RuntimeError:
            # Asking first would look through the list of all chunks for each of them.
            if data.id.get_chunk_info_by_coord(place).byte_offset is None:
                return None
            raise
        if left_out:
            raise ValueError("a chunk stored without its filters")
        # libdeflate expands shuffled winds in 0.6 of the time ISA-L takes, and in half of zlib's
        plain = deflate.zlib_decompress(octets, size) if codes else octets
        return _taken(plain, size, width, flat, shuffled=2 in codes)

    return data.chunks, data.dtype, fetch


def _of_zarr(path: Path, name: str) -> _Stored | None:
    folder = path / name
    if (folder / ".zarray").is_file():
        return _of_zarr2(folder)
    told = json.loads((folder / "zarr.json").read_text())
    grid, keys = told["chunk_grid"], told["chunk_key_encoding"]
    codecs = [(one["name"], one.get("configuration", {})) for one in told["codecs"]]
    if grid["name"] != "regular" or keys["name"] != "default" or told["storage_transformers"]:
        return None
    if not codecs or codecs[0][0] != "bytes" or len(codecs) > 2:
        return None
    lengths = tuple(int(n) for n in grid["configuration"]["chunk_shape"])
    order = ">" if codecs[0][1].get("endian") == "big" else "<"
    dtype = np.dtype(str(told["data_type"])).newbyteorder(order)  # type: ignore[arg-type]
    expand = _expander(codecs[1][0] if len(codecs) == 2 else "", lengths, dtype.itemsize)
    if expand is None:
        return None
    between = keys.get("configuration", {}).get("separator", "/")
    return lengths, dtype, _files(folder, lengths, "c" + between, between, expand)


def _of_zarr2(folder: Path) -> _Stored | None:
    told = json.loads((folder / ".zarray").read_text())
    if told["order"] != "C" or told["filters"]:
        return None
    lengths, dtype = tuple(int(n) for n in told["chunks"]), np.dtype(told["dtype"])
    compressor = told["compressor"]
    expand = _expander(compressor["id"] if compressor else "", lengths, dtype.itemsize)
    if expand is None:
        return None
    between = told.get("dimension_separator", ".")
    return lengths, dtype, _files(folder, lengths, "", between, expand)


def _expander(name: str, lengths: tuple[int, ...], width: int) -> _Expand | None:
    """What expands a compressed chunk; None for what is not known."""
    import deflate
    import numcodecs  # type: ignore[import-untyped]
    from isal import igzip

    from airswing.reference.gridded.blosc_blocks import octets_of_blocks

    size = int(np.prod(lengths)) * width
    if name == "blosc":

        def of_blocks(file: io.FileIO, flat: Ints) -> Octets:
            wanted = flat[:, None] * width + np.arange(width)
            return octets_of_blocks(file, size, wanted.ravel()).reshape(wanted.shape)

        return of_blocks
    expand: dict[str, Callable[[bytes], _Expanded]] = {
        "": bytes,
        "zlib": lambda octets: deflate.zlib_decompress(octets, size),
        "gzip": igzip.decompress,
    }
    if name in ("zstd", "lz4"):
        expand[name] = numcodecs.get_codec({"id": name}).decode
    if name not in expand:
        return None
    one = expand[name]
    return lambda file, flat: _taken(one(file.read()), size, width, flat)


def _files(
    folder: Path, lengths: tuple[int, ...], start: str, between: str, expand: _Expand
) -> Fetch:
    def fetch(place: tuple[int, ...], flat: Ints) -> Octets | None:
        numbers = (str(at // length) for at, length in zip(place, lengths, strict=True))
        try:
            with open(folder / (start + between.join(numbers)), "rb", buffering=0) as file:
                return expand(file, flat)
        except FileNotFoundError:
            return None

    return fetch
