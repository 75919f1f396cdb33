"""Files from which a run is carried on: a line that says what follows, then arrays in NumPy's npz format.

The line holds the format's version and the length and SHA-256 sum of the rest, so that no torn or foreign file is taken
for a checkpoint. A new one is written beside the old one and takes its name when it is complete on disk: whatever the
instant of a kill, a power cut or a full disk, there is one whole checkpoint under the name.
"""

import contextlib
import hashlib
import io
import json
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

VERSION = 1
_LINE = re.compile(rb"jaxmps checkpoint (\d{1,9}) ([0-9a-f]{64}) (\d{1,18})\n")
_LONGEST = 128  # bytes of that line
_HEADER = "header"


def checkpoint_of(run: Path) -> Path:
    """Where the checkpoint of the run in the file `run` lies."""
    return run.with_name(run.name + ".checkpoint")


def write_checkpoint(path: Path, header: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> None:
    """Replaces the checkpoint at `path`; `header` is JSON. `OSError` if that fails: the old one is still there then."""
    buffer = io.BytesIO()
    described = np.frombuffer(json.dumps(header).encode(), np.uint8)
    np.savez(buffer, allow_pickle=False, **{_HEADER: described}, **arrays)
    payload = buffer.getbuffer()
    line = f"jaxmps checkpoint {VERSION} {hashlib.sha256(payload).hexdigest()} {len(payload)}\n"
    replace_file(path, line.encode(), payload)


def read_checkpoint(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and arrays of the checkpoint at `path`.

    Raises `FileNotFoundError` if there is none, and `ValueError` for a file that is none, is truncated or damaged, or
    is of a newer version.
    """
    with path.open("rb") as file:
        found = _LINE.match(file.readline(_LONGEST))
        if not found:
            raise ValueError(f"{path} is not a jaxmps checkpoint")
        version, digest, length = int(found[1]), found[2].decode(), int(found[3])
        if version > VERSION:
            raise ValueError(
                f"{path} is a checkpoint of format {version}, this jaxmps reads {VERSION}: it needs a newer jaxmps"
            )
        payload = file.read()
    if len(payload) < length:
        raise ValueError(f"{path} is truncated: it has {len(payload)} of the {length} bytes of its checkpoint")
    if len(payload) > length or hashlib.sha256(payload).hexdigest() != digest:
        raise ValueError(f"{path} is damaged: its content does not match its checksum")
    with np.load(io.BytesIO(payload), allow_pickle=False) as stored:
        arrays = {name: stored[name] for name in stored.files}
    return json.loads(arrays.pop(_HEADER).tobytes()), arrays


def replace_file(path: Path, *parts: Any) -> None:
    """Makes the file at `path` one of these bytes, at once and durably; if that fails, it stays as it was.

    Raises `OSError` that says so.
    """
    partial = path.with_name(path.name + ".partial")
    try:
        with partial.open("wb") as file:
            for part in parts:
                file.write(part)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
        sync(path.parent)  # the name, too, has to outlast a power cut
    except OSError as error:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
        kept = "; the one before it is intact" if path.exists() else ""
        raise OSError(f"{path} could not be written: {error.strerror or error}{kept}") from error


def sync(path: Path) -> None:
    """Waits until the file or folder at `path` is on disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
