"""What brings the file of a run back to an earlier instant, after a kill amid a write or frames that are not to count.

HDF5 itself may be unreadable after a kill: its metadata are changed in place, by several writes. But the chunks of the
frames stay where they are, and rows that are written are not touched again. So an image holds all bytes of the file
that are not in these chunks, some 30 for each particle, and its length; put back, they make the file what it was, with
the frames of then and none after. A copy of the whole file would do the same at a cost that grows with its frames, a
second record of the frames would double what is written, and HDF5's own SWMR mode keeps readers from torn metadata but
needs its newest layout, which marks files as open, and not all viewers have it.
"""

import hashlib
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from jaxmps.io import layout
from jaxmps.io.checkpoint import sync

_COLUMNS = ("Points", *(f"PointData/{name}" for name in layout.CHANGING))


def take(path: Path) -> dict[str, np.ndarray]:
    """The image of the file at `path`, which is on disk then: arrays for a checkpoint."""
    sync(path)
    with layout.open_file(path, "r") as file:
        chunks, last = sorted(_chunks(file["VTKHDF"])), list(_last_frame(file["VTKHDF"]))
    size, pieces, at = path.stat().st_size, [], 0
    for begin, end in [*chunks, (size, size)]:
        if begin > at:
            pieces.append((at, begin - at))
        at = max(at, end)
    with path.open("rb") as raw:
        content = _bytes_of(raw, pieces)
        digest = hashlib.sha256(_bytes_of(raw, last)).digest()
    return {
        "pieces": np.array(pieces, np.int64),
        "bytes": np.frombuffer(content, np.uint8),
        "size": np.array(size),
        "last_frame": np.array(last, np.int64).reshape(-1, 2),
        "last_frame_sum": np.frombuffer(digest, np.uint8),
    }


def put_back(path: Path, image: Mapping[str, np.ndarray]) -> None:
    """Makes the file at `path` what it was when the image was taken.

    It may be done again after a kill. Raises `ValueError`, with nothing changed, if the file is missing or another one.
    """
    if not path.is_file():
        raise ValueError(f"{path} is missing: the frames before its checkpoint are nowhere else")
    content, at = image["bytes"].tobytes(), 0
    with path.open("r+b") as raw:
        digest = hashlib.sha256(_bytes_of(raw, image["last_frame"].tolist())).digest()
        if digest != image["last_frame_sum"].tobytes():
            raise ValueError(f"{path} is not the file of its checkpoint: the last frame is another one")
        for start, length in image["pieces"].tolist():
            raw.seek(start)
            raw.write(content[at : at + length])
            at += length
        raw.truncate(int(image["size"]))
        raw.flush()
        os.fsync(raw.fileno())


def _chunks(root: Any) -> Iterator[tuple[int, int]]:
    """First byte of each chunk of frames, and the one behind it."""
    for name in _COLUMNS:
        stored = root[name].id
        for index in range(stored.get_num_chunks()):
            chunk = stored.get_chunk_info(index)
            yield chunk.byte_offset, chunk.byte_offset + chunk.size


def _last_frame(root: Any) -> Iterator[tuple[int, int]]:
    """Where the last frame that counts lies, and how many bytes: a frame is never in two chunks."""
    frames, particles = int(root["Steps"].attrs["NSteps"]), int(root["NumberOfPoints"][0])
    first = (frames - 1) * particles
    for name in _COLUMNS if frames else ():
        stored = root[name]
        chunk = stored.id.get_chunk_info_by_coord((first, *(0 for _ in stored.shape[1:])))
        row = chunk.size // stored.chunks[0]
        yield chunk.byte_offset + (first - chunk.chunk_offset[0]) * row, particles * row


def _bytes_of(raw: BinaryIO, pieces: Iterable[Sequence[int]]) -> bytes:
    found = []
    for start, length in pieces:
        raw.seek(start)
        found.append(raw.read(length))
    return b"".join(found)
