"""Decompression: what is whole, what is cut, what is a bomb."""

from __future__ import annotations

import io
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard

from calibration_core.recording.storage.compression import (
    MAX_CHUNK,
    decompress,
    decompress_file,
    decompress_message,
)

LIMIT = 64 << 20
DATA = np.random.default_rng(0).integers(0, 40, 600_000).astype(np.uint8).tobytes()
PACK = {"zstd": zstandard.ZstdCompressor().compress, "lz4": lz4.frame.compress}


@pytest.mark.parametrize("form", PACK)
def test_round_trip(form: str) -> None:
    assert decompress(PACK[form](DATA), form, len(DATA)) == DATA


@pytest.mark.parametrize("form", PACK)
def test_frames_one_after_another_without_size(form: str) -> None:
    if form == "zstd":
        unsized = zstandard.ZstdCompressor(write_content_size=False)
        packed = unsized.compress(DATA[:1000]) + unsized.compress(DATA[1000:])
        assert decompress(packed, form, len(DATA)) == DATA
    else:
        assert decompress(lz4.frame.compress(DATA, store_size=False), form, len(DATA)) == DATA


@pytest.mark.parametrize("form", PACK)
@pytest.mark.parametrize("claim", [0, 1000, len(DATA) - 1, len(DATA) + 1, MAX_CHUNK + 1, 2**60])
def test_wrong_claims(form: str, claim: int) -> None:
    with pytest.raises(ValueError, match="bytes"):
        decompress(PACK[form](DATA), form, claim)


@pytest.mark.parametrize("form", PACK)
def test_a_bomb_makes_no_more_than_it_claims(form: str) -> None:
    bomb = PACK[form](bytes(256 << 20))
    with pytest.raises(ValueError, match="claims 1000"):
        decompress(bomb, form, 1000)


@pytest.mark.parametrize("form", PACK)
def test_damage(form: str) -> None:
    packed = bytearray(PACK[form](DATA))
    packed[0] ^= 0xFF
    with pytest.raises(ValueError, match="damaged"):
        decompress(bytes(packed), form, len(DATA))


@pytest.mark.parametrize("form", PACK)
def test_cut_off_gives_what_is_whole(form: str) -> None:
    packed = PACK[form](DATA)
    part = decompress(packed[: len(packed) * 3 // 4], form, len(DATA), partial=True)
    assert 0 < len(part) < len(DATA)
    assert DATA.startswith(part)


def test_message() -> None:
    assert decompress_message(PACK["zstd"](b"message")) == b"message"
    with pytest.raises(ValueError, match="more than"):
        decompress_message(PACK["zstd"](bytes(32 << 20)))


def test_file(tmp_path: Path) -> None:
    source = tmp_path / "a.zstd"
    packed = PACK["zstd"](DATA[:1000]) + PACK["zstd"](DATA[1000:])
    source.write_bytes(packed)
    target = io.BytesIO()
    assert decompress_file(source, target, LIMIT)
    assert target.getvalue() == DATA
    source.write_bytes(packed[:-1000])
    target = io.BytesIO()
    assert not decompress_file(source, target, LIMIT)
    assert DATA.startswith(target.getvalue())


def test_file_that_is_a_bomb(tmp_path: Path) -> None:
    source = tmp_path / "bomb.zstd"
    source.write_bytes(PACK["zstd"](bytes(256 << 20)))
    target = io.BytesIO()
    with pytest.raises(ValueError, match="more than"):
        decompress_file(source, target, LIMIT)
    assert target.tell() <= LIMIT


def test_file_that_is_no_zstd(tmp_path: Path) -> None:
    source = tmp_path / "text.zstd"
    source.write_bytes(b"no zstd at all")
    with pytest.raises(ValueError, match="no zstd data"):
        decompress_file(source, io.BytesIO(), LIMIT)
