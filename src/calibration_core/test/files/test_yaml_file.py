"""One reader for every YAML file: plain values with their places, everything else refused at its line and column."""

from __future__ import annotations

import math
import os
import time
from pathlib import Path

import pytest
import yaml

from calibration_core.errors import CellError, InputError, PlanError
from calibration_core.files.yaml_file import MAX_DEPTH, read_yaml, yaml_text

ROOT = Path(__file__).resolve().parents[4]
MOST = 20 << 20
BOMB = "a0: &a0 [x]\n" + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 13))
MERGES = "a0: &a0 {x: 1}\n" + "".join(f"a{i}: &a{i} {{<<: [*a{i - 1}, *a{i - 1}], y{i}: 1}}\n" for i in range(1, 30))


def load(tmp_path: Path, text: str | bytes) -> object:
    path = tmp_path / "file.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_yaml(path, MOST, "file of a test", PlanError).data


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("", None), ("~", None), ("null", None), ("a", "a"), ("'1'", "1"), ('"a\\nb"', "a\nb"), ("yes", True),
        ("False", False), ("'yes'", "yes"), ("0", 0), ("-12", -12), ("+1_000", 1000), ("0x1F", 31), ("1.", 1.0),
        (".5", 0.5), ("-2.0e-5", -2e-5), ("1e5", 1e5), ("1.4e6", 1.4e6), ("1e-3", 1e-3), (".inf", math.inf),
        ("-.INF", -math.inf), ("010", "010"), ("0123456", "0123456"), ("1:59:59", "1:59:59"),
        ("2024-01-05", "2024-01-05"), ("1.2.3", "1.2.3"), ("1e", "1e"), (".", "."), ("-", [None]), ("e5", "e5"),
        ("18446744073709551616", 1 << 64), ("[1, 2.5, a]", [1, 2.5, "a"]), ("{a: {b: [1]}}", {"a": {"b": [1]}}),
        ("1: a\nno: b", {"1": "a", "no": "b"}), ("a: |\n  b\n  c\n", {"a": "b\nc\n"}), ("a:\n- 1\n", {"a": [1]}),
        ("=", "="), ("a: &anchor 1", {"a": 1}), ("\ufeffa: 1", {"a": 1}), ("\u00e9: \u00b5", {"\u00e9": "\u00b5"}),
    ],
)  # fmt: skip
def test_values(tmp_path: Path, text: str, value: object) -> None:
    found = load(tmp_path, text)
    assert found == value
    assert type(found) is type(value)


def test_not_a_number(tmp_path: Path) -> None:
    value = load(tmp_path, ".nan")
    assert isinstance(value, float)
    assert math.isnan(value)


@pytest.mark.parametrize(
    ("text", "line", "column", "found"),
    [
        ("a: !!bool foo", 1, 4, "the tag"),
        ("a: !!timestamp foo", 1, 4, "the tag"),
        ("a: !!int ''", 1, 4, "the tag"),
        ("a: !!python/object/apply:os.system [x]", 1, 4, "the tag"),
        ("a: !own 1", 1, 4, "the tag"),
        ("b: 1\na: *x", 2, 4, "the alias *x"),
        ("b: &x 1\na: *x", 2, 4, "the alias *x"),
        ("b: {c: 1}\na:\n  <<: {c: 1}", 3, 3, "a merge key"),
        ("a: 1\nb: 2\na: 3", 3, 1, "key 'a' twice"),
        ("{a: 1, 'a': 2}", 1, 8, "key 'a' twice"),
        ("? [1, 2]\n: 3", 1, 3, "a list or mapping as a key"),
        ("a: 1\n---\nb: 2", 2, 1, "a second document"),
        (f"a: {'9' * 400}", 1, 4, "a number of 400 characters"),
        (f"a: 0x{'F' * 5000}", 1, 4, "a number of 5002 characters"),
        ("a: 18446744073709551617", 1, 4, "an integer beyond 1.84e+19"),
        ("a: 1e400", 1, 4, "1e400, too large for a number"),
        (f"{'k' * 900}: 1", 1, 1, "a key of 900 characters"),
        ("a: [1, 2", 2, 1, "did not find expected"),
        ("a: b: c", 1, 5, "mapping values are not allowed"),
        ("a: 1\n\tb: 2", 2, 1, "a tab character that violates indentation"),
        (b"a: 1\nb: \xff", 2, 4, "'\\xff'"),
        ("[" * 60, 1, MAX_DEPTH + 1, f"more than {MAX_DEPTH} levels"),
    ],
)  # fmt: skip
def test_what_is_refused_and_where(tmp_path: Path, text: str | bytes, line: int, column: int, found: str) -> None:
    with pytest.raises(PlanError) as caught:
        load(tmp_path, text)
    error = caught.value
    assert (error.line, error.column) == (line, column)
    assert found in error.found
    assert str(error).startswith(f"{tmp_path / 'file.yaml'}:{line}:{column}: found ")


@pytest.mark.parametrize(
    "text",
    [
        BOMB, MERGES, "[" * 500_000, "{a: " * 200_000, "- " * 500_000, "? " * 200_000,
        "a: " + "[" * 100_000 + "]" * 100_000, " " * 3_000_000 + "a: 1\n b", "\x00" * 1000, "\x07",
        "%TAG ! tag:x,2000:\n--- !y 1", "a: " + "1:59" * 100_000 + ":x: 1", "&" * 1_000_000, "!" * 1_000_000,
        "'" * 999_999, "[1]\n" * 300_000, "x: {" + "a," * 500_000,
    ],
    ids=range(17),
)  # fmt: skip
def test_hostile_text_is_refused_at_once(tmp_path: Path, text: str) -> None:
    begin = time.process_time()
    with pytest.raises(PlanError) as caught:
        load(tmp_path, text)
    assert time.process_time() - begin < 4.0
    assert len(str(caught.value).splitlines()) == 1
    assert len(str(caught.value)) < 1000


def test_only_regular_files(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "large").write_bytes(b"a" * 101)
    names = {"/dev/zero": "no regular file", tmp_path / "pipe": "no regular file", tmp_path: "a directory"}
    names |= {tmp_path / "none": "No such file", tmp_path / "loop": "Too many levels", tmp_path / "large": "101 bytes"}
    names |= {tmp_path / ("x" * 5000): "File name too long", "a\x00b": "null byte", tmp_path / "a\nb": "No such file"}
    for name, found in names.items():
        with pytest.raises(InputError) as caught:
            read_yaml(name, 100, "file of a test")
        assert found in caught.value.found
        assert len(str(caught.value).splitlines()) == 1
        assert len(str(caught.value)) < 600


def test_places(tmp_path: Path) -> None:
    path = tmp_path / "file.yaml"
    path.write_text("a: 1\nb:\n  c.d: [1,\n    2]\n  e: {f: 1}\n")
    file = read_yaml(path, MOST, "file of a test")
    assert file.where("a") == (1, 4)
    assert file.where("b") == (2, 1)
    assert file.where("b.c.d") == (3, 3)
    assert file.where("b.c.d.1") == (4, 5)
    assert file.where("b.e.f") == (5, 10)
    assert file.where("b.e.g.h") == (5, 3)  # the deepest that exists
    assert file.where("") is None
    assert file.where("z") is None
    with pytest.raises(CellError) as caught, file.locating():
        raise CellError(path, "b.c.d.1", "2", "3")
    assert str(caught.value) == f"{path}:4:5: b.c.d.1: found 2, expected 3"
    with pytest.raises(CellError) as elsewhere, file.locating():
        raise CellError(tmp_path / "other.yaml", "a", "2", "3")
    assert elsewhere.value.line is None


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    shared = [1.5]
    words = ["1e5", "yes", "010", "0x1", "1:59", "2024-01-05", "~", "", "a b", "- x", "<<", "=", ".5", "1_0", "é", "'"]
    data = {"words": words, "numbers": [1e-5, 1e300, 5, -0.0], "twice": [shared, shared], "none": None, "yes": True}
    for flow in (False, None):
        assert load(tmp_path, yaml_text(data, flow=flow)) == data
    assert yaml.safe_load(yaml_text(data)) == data  # and so do other readers


@pytest.mark.parametrize("path", sorted((ROOT / "config").rglob("*.yaml")), ids=lambda path: path.name)
def test_our_files_mean_the_same_to_other_readers(path: Path) -> None:
    assert read_yaml(path, MOST, "file").data == yaml.safe_load(path.read_text(encoding="utf-8"))
