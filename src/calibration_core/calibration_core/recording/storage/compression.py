"""Decompression that cannot be made to fill the memory: the claimed size bounds the work, a cap bounds the claim."""

from __future__ import annotations

from pathlib import Path
from typing import IO

import lz4.frame
import zstandard

MAX_CHUNK = 64 << 20  # bytes of one decompressed chunk; recorders write 1 MB to 8 MB
MAX_MESSAGE = 16 << 20  # bytes of one message
MAX_RATIO = 200  # decompressed : stored, of what is read of a file; real recordings stay below 30
FREE_SHARE = 0.5  # of the free space that a decompressed file may take; black images shrink ten thousandfold
MIN_BUDGET = 64 << 20
_WINDOW = 1 << 27
_STEP = 1 << 12  # bytes of zstd input per call: at most 128 MB come out


def budget(stored: int) -> int:
    """Return how many bytes of use a file of `stored` bytes may plausibly hold."""
    return MIN_BUDGET + MAX_RATIO * stored


def decompress(data: bytes, compression: str, size: int, *, partial: bool = False) -> bytes:
    """Decompress a chunk.

    Args:
        data: Compressed bytes.
        compression: `zstd` or `lz4` (frame format).
        size: What the chunk claims to be decompressed; never more is produced.
        partial: The data are known to be cut off: return what can be had.

    Raises:
        ValueError: The data are damaged, or do not have the claimed size.
    """
    if size > MAX_CHUNK:
        msg = f"a chunk of {size} bytes"
        raise ValueError(msg)
    raw = _zstd(data, size, partial) if compression == "zstd" else _lz4(data, size, partial)
    if len(raw) != size and not partial:
        msg = f"{len(raw)} bytes where the chunk claims {size}"
        raise ValueError(msg)
    return raw


def _zstd(data: bytes, size: int, partial: bool) -> bytes:
    parts: list[bytes] = []
    have = 0
    with zstandard.ZstdDecompressor(max_window_size=_WINDOW).stream_reader(data, read_across_frames=True) as stream:
        while have <= size:
            try:
                part = stream.read(min(1 << 20, size + 1 - have))
            except zstandard.ZstdError as error:
                if partial:
                    break
                msg = f"damaged zstd data ({error})"
                raise ValueError(msg) from None
            if not part:
                break
            parts.append(part)
            have += len(part)
    return b"".join(parts)


def _lz4(data: bytes, size: int, partial: bool) -> bytes:
    decompressor = lz4.frame.LZ4FrameDecompressor()
    parts: list[bytes] = []
    have = 0
    step = 1 << 16  # small enough that a cut-off frame still yields what precedes the cut
    at = 0
    try:
        while have <= size and not decompressor.eof and (at < len(data) or not decompressor.needs_input):
            block = data[at : at + step] if decompressor.needs_input else b""
            at += len(block)
            part = decompressor.decompress(block, max_length=size + 1 - have)
            parts.append(part)
            have += len(part)
    except RuntimeError as error:
        if not partial:
            msg = f"damaged lz4 data ({error})"
            raise ValueError(msg) from None
    return b"".join(parts)


def decompress_message(data: bytes) -> bytes:
    """Decompress one message of a bag in zstd message compression.

    Raises:
        ValueError: The data are damaged or larger than `MAX_MESSAGE`.
    """
    raw = _zstd(data, MAX_MESSAGE, partial=False)
    if len(raw) > MAX_MESSAGE:
        msg = f"a message of more than {MAX_MESSAGE} bytes"
        raise ValueError(msg)
    return raw


def decompress_file(source: Path, target: IO[bytes], limit: float) -> bool:
    """Decompress a zstd file into `target`, at most `limit` bytes, as far as it is whole.

    Returns:
        Whether the file was complete.

    Raises:
        ValueError: It is no zstd file, or grows beyond the limit.
        OSError: It cannot be read, or the target not written.
    """
    written = 0
    frame = _frame()
    with source.open("rb") as stored:
        while block := stored.read(_STEP):
            while block:
                if frame.eof:
                    frame = _frame()
                try:
                    part = frame.decompress(block)
                except zstandard.ZstdError as error:
                    if written:
                        return False
                    msg = f"no zstd data ({error})"
                    raise ValueError(msg) from None
                block = frame.unused_data if frame.eof else b""
                written += len(part)
                if written > limit:
                    msg = f"more than {limit:.0f} bytes of decompressed data"
                    raise ValueError(msg)
                target.write(part)
    return bool(frame.eof)


def _frame() -> zstandard.ZstdDecompressionObj:
    return zstandard.ZstdDecompressor(max_window_size=_WINDOW).decompressobj()
