"""One reader for every YAML file: plain data only, bounded, and every value knows its line and column.

Tags, aliases, merge keys, keys that stand twice and several documents in one file are refused: nobody needs them to
describe a cell, and each has been used to make a reader run code, fill the memory, or take one value for another.
Keys are text.  See `yaml_scalars` for what plain values mean.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from calibration_core.errors import InputError, quoted
from calibration_core.files.regular import read_regular
from calibration_core.files.yaml_scalars import FLOAT, resolve

MAX_DEPTH = 50
MAX_VALUES = 1_000_000
MAX_KEY = 500
PLAIN = "plain YAML without tags, aliases, merge keys and repeated keys"
_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # the fast one, if any
_Dumper: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)

Mark = tuple[int, int]
"""Line and column, both from 1."""


@dataclasses.dataclass(frozen=True, eq=False)
class YamlFile:
    """What a YAML file holds.

    Attributes:
        data: Its content: dictionaries with text as keys, lists, and plain values; None for an empty file.
    """

    path: Path
    data: Any
    raw: bytes
    _marks: dict[int, dict[str | int, Mark]]

    def where(self, place: str) -> Mark | None:
        """Return line and column of a value, or of the deepest part of its place that exists.

        Args:
            place: Keys and list indices with dots between, e.g. `robot.dh.1.a`; keys may have dots themselves.
        """
        parts = place.split(".") if place else []
        value, mark = self.data, None
        while parts:
            for length in range(len(parts), 0, -1):
                key: str | int = ".".join(parts[:length])
                if isinstance(value, list):
                    key = int(key) if str(key).isdecimal() and len(str(key)) < 10 else -1
                marks = self._marks.get(id(value), {})
                if key in marks:
                    value, mark, parts = value[key], marks[key], parts[length:]
                    break
            else:
                return mark
        return mark

    @contextlib.contextmanager
    def locating(self) -> Iterator[None]:
        """Give errors about this file that are raised inside line and column of their place."""
        try:
            yield
        except InputError as error:
            mark = self.where(error.place) if error.file == str(self.path) and error.line is None else None
            if mark is None:
                raise
            raise error.at(*mark) from None


def read_yaml(path: str | Path, most: int, what: str, error: type[InputError] = InputError) -> YamlFile:
    """Read a YAML file.

    Args:
        path: The file.
        most: Bytes that it may have.
        what: What it should be, for messages, e.g. `cell file (YAML)`.
        error: Kind of error to raise.

    Raises:
        InputError: It cannot be read, is no regular file, too large, not UTF-8, no YAML, or YAML that is not plain;
            names line and column.
    """
    path = Path(path)
    raw = read_regular(path, most, what, error)
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as fault:
        line = raw.count(b"\n", 0, fault.start) + 1
        column = fault.start - (raw.rfind(b"\n", 0, fault.start) + 1) + 1
        raise error(path, "", quoted(raw[fault.start : fault.start + 1]), "UTF-8").at(line, column) from None
    reader = _Reader(path, error)
    try:
        for event in yaml.parse(text, Loader=_Loader):
            reader.take(event)
    except yaml.YAMLError as fault:
        problem = getattr(fault, "problem", None) or getattr(fault, "reason", None) or "no YAML"
        wrong = error(path, "", str(problem).removeprefix("found "), "YAML")
        mark = getattr(fault, "problem_mark", None)
        raise (wrong if mark is None else wrong.at(mark.line + 1, mark.column + 1)) from None
    return YamlFile(path, reader.root, raw, reader.marks)


def yaml_text(data: object, *, width: int = 120, flow: bool | None = False) -> str:
    """Return plain data as YAML that `read_yaml` reads back equal; keys keep their order, zeros have no sign.

    Args:
        data: Dictionaries, lists and plain values.
        width: Where lines are broken.
        flow: False: one value per line; None: innermost lists and mappings in one line.
    """
    text: str = yaml.dump(
        data, Dumper=_Quoting, sort_keys=False, allow_unicode=True, width=width, default_flow_style=flow
    )
    return text


class _Quoting(_Dumper):  # type: ignore[misc]  # yaml has no types
    """Quotes text that the reader would take for a number, and repeats what stands twice instead of aliases."""

    def ignore_aliases(self, _: object) -> bool:
        return True

    def represent_unsigned(self, value: float) -> Any:
        return self.represent_float(value + 0.0)  # see `written`


_Quoting.add_representer(float, _Quoting.represent_unsigned)
_Quoting.add_implicit_resolver("tag:yaml.org,2002:float", FLOAT, list("-+.0123456789"))


@dataclasses.dataclass
class _Open:
    """A list or mapping that is being read; of a mapping also the key that waits for its value."""

    content: Any
    marks: dict[str | int, Mark]
    key: str | None = None
    key_mark: Mark = (0, 0)

    @property
    def wants_key(self) -> bool:
        return self.key is None and isinstance(self.content, dict)


class _Reader:
    """Puts the events of a YAML stream together; no recursion, so that depth is no matter of the stack."""

    def __init__(self, path: Path, error: type[InputError]) -> None:
        self.path, self.error = path, error
        self.root: Any = None
        self.marks: dict[int, dict[str | int, Mark]] = {}
        self._open: list[_Open] = []
        self._values = 0
        self._documents = 0

    def take(self, event: Any) -> None:
        mark = (event.start_mark.line + 1, event.start_mark.column + 1)
        if isinstance(event, yaml.AliasEvent):
            raise self._fault(mark, f"the alias *{event.anchor}", PLAIN)
        if isinstance(event, yaml.DocumentStartEvent):
            self._documents += 1
            if self._documents > 1:
                raise self._fault(mark, "a second document", "one YAML document")
            return
        tag = getattr(event, "tag", None)
        if tag is not None:
            raise self._fault(mark, f"the tag {tag}", PLAIN)
        if isinstance(event, yaml.ScalarEvent):
            self._scalar(event, mark)
        elif isinstance(event, yaml.CollectionStartEvent):
            self._begin({} if isinstance(event, yaml.MappingStartEvent) else [], mark)
        elif isinstance(event, yaml.CollectionEndEvent):
            self._open.pop()

    def _scalar(self, event: Any, mark: Mark) -> None:
        if self._open and self._open[-1].wants_key:
            key = str(event.value)
            if event.implicit[0] and key == "<<":
                raise self._fault(mark, "a merge key", PLAIN)
            if len(key) > MAX_KEY:
                raise self._fault(mark, f"a key of {len(key)} characters", f"at most {MAX_KEY}")
            if key in self._open[-1].content:
                raise self._fault(mark, f"key {quoted(key)} twice", "every key once")
            self._open[-1].key, self._open[-1].key_mark = key, mark
            return
        try:
            value = resolve(event.value) if event.implicit[0] else event.value
        except ValueError as fault:
            raise self._fault(mark, str(fault), "a number that fits into 64 bits") from None
        self._place(value, mark)

    def _begin(self, container: dict[str, Any] | list[Any], mark: Mark) -> None:
        if self._open and self._open[-1].wants_key:
            raise self._fault(mark, "a list or mapping as a key", "text as keys")
        if len(self._open) == MAX_DEPTH:
            raise self._fault(mark, f"more than {MAX_DEPTH} levels of nesting", "plain YAML")
        self._place(container, mark)
        self.marks[id(container)] = {}
        self._open.append(_Open(container, self.marks[id(container)]))

    def _place(self, value: Any, mark: Mark) -> None:
        self._values += 1
        if self._values > MAX_VALUES:
            raise self._fault(mark, f"more than {MAX_VALUES} values", "a smaller file")
        if not self._open:
            self.root = value
            return
        parent = self._open[-1]
        if parent.key is None:
            parent.marks[len(parent.content)] = mark
            parent.content.append(value)
            return
        parent.content[parent.key] = value
        parent.marks[parent.key] = parent.key_mark if isinstance(value, dict | list) else mark
        parent.key = None

    def _fault(self, mark: Mark, found: str, expected: str) -> InputError:
        return self.error(self.path, "", found, expected).at(*mark)
