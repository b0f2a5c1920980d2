"""The part of OMG IDL in which `rosidl` writes message types: modules, structs, typedefs of arrays."""

from __future__ import annotations

import re

from calibration_core.recording.definitions.fields import (
    MAX_TYPES,
    SEPARATOR,
    SIZES,
    TEXT,
    MessageField,
    array_size,
)

BASE = {
    "boolean": "bool", "octet": "uint8", "char": "uint8", "float": "float32", "double": "float64", "short": "int16",
    "long": "int32",
    "string": TEXT, **{name: name for name in SIZES if "int" in name},
}  # fmt: skip
_IGNORED = re.compile(
    r"//[^\n]*|/\*(?:.*?\*/|.*)|^[ \t]*#[^\n]*|^IDL:[^\n]*|@[a-z_]+[ \t]*(?:\((?:\"(?:\\.|[^\"\\])*\"|[^()\"])*\))?",
    re.MULTILINE | re.DOTALL,
)
_TOKEN = re.compile(r"\s*(?:([A-Za-z_][A-Za-z0-9_]*(?:::[A-Za-z_][A-Za-z0-9_]*)*)|(\d{1,10})\b|([{}\[\]<>;,=]))")


class _Tokens:
    def __init__(self, text: str) -> None:
        self._text, self._at = _IGNORED.sub(" ", text).rstrip(), 0

    def next(self) -> str:
        match = _TOKEN.match(self._text, self._at)
        if match is None:
            msg = f"{self._text[self._at : self._at + 40].strip()!r}" if self._at < len(self._text) else "an early end"
            raise ValueError(msg)
        self._at = match.end()
        return match[1] or match[2] or match[3]

    def expect(self, token: str) -> None:
        found = self.next()
        if found != token:
            msg = f"{found[:40]!r} instead of {token!r}"
            raise ValueError(msg)

    def skip(self) -> None:
        """Go behind the next semicolon, whatever stands before it."""
        end = self._text.find(";", self._at)
        if end < 0:
            msg = "a statement without an end"
            raise ValueError(msg)
        self._at = end + 1

    @property
    def ended(self) -> bool:
        return self._at >= len(self._text)


def parse_idl(text: str) -> dict[str, tuple[MessageField, ...]]:
    """Return type -> fields of everything in the text.

    Raises:
        ValueError: It is not the IDL that `rosidl` writes; the text says where.
    """
    types: dict[str, tuple[MessageField, ...]] = {}
    tokens = _Tokens(SEPARATOR.sub("", text))
    scope: list[str] = []
    arrays: dict[str, MessageField] = {}
    while not tokens.ended:
        word = tokens.next()
        if word == "module":
            scope.append(tokens.next())
            tokens.expect("{")
        elif word == "}":
            if not scope:
                msg = "a closing brace too many"
                raise ValueError(msg)
            scope.pop()
            tokens.expect(";")
        elif word == "const":
            tokens.skip()
        elif word == "typedef":
            field = _declared(tokens, tokens.next(), arrays)
            arrays[field.name] = field
        elif word == "struct":
            name = "/".join([*scope, tokens.next()])
            tokens.expect("{")
            fields: list[MessageField] = []
            while (word := tokens.next()) != "}":
                fields.append(_declared(tokens, word, arrays))
            tokens.expect(";")
            types[name] = () if [field.name for field in fields] == [EMPTY] else tuple(fields)
        else:
            msg = f"the statement {word[:40]!r}"
            raise ValueError(msg)
        if len(types) > MAX_TYPES:
            msg = f"more than {MAX_TYPES} types"
            raise ValueError(msg)
    if scope:
        msg = "an early end"
        raise ValueError(msg)
    return types


EMPTY = "structure_needs_at_least_one_member"


def _declared(tokens: _Tokens, word: str, arrays: dict[str, MessageField]) -> MessageField:
    """Read a declaration up to its semicolon: `type name;` or `type name[size];`, `word` being its first token."""
    shape: str = "one"
    if word == "sequence":
        tokens.expect("<")
        kind = _type(tokens, tokens.next(), arrays)
        if kind.shape != "one":
            msg = "a sequence of arrays"
            raise ValueError(msg)
        shape, close = "sequence", tokens.next()
        if close == ",":
            tokens.next()
            close = tokens.next()
        if close != ">":
            msg = f"{close[:40]!r} in a sequence"
            raise ValueError(msg)
        name = tokens.next()
    else:
        kind = _type(tokens, word, arrays)
        name = tokens.next()
        if name == "<":  # a bounded string
            tokens.next()
            tokens.expect(">")
            name = tokens.next()
    after = tokens.next()
    if after == "[":
        size = array_size(tokens.next())
        tokens.expect("]")
        tokens.expect(";")
        if shape != "one" or kind.shape != "one":
            msg = "an array of arrays"
            raise ValueError(msg)
        return MessageField(name, kind.type, "array", size)
    if after != ";":
        msg = f"{after[:40]!r} behind {name[:40]!r}"
        raise ValueError(msg)
    if shape == "sequence":
        return MessageField(name, kind.type, "sequence", 0)
    return MessageField(name, kind.type, kind.shape, kind.size)


def _type(tokens: _Tokens, word: str, arrays: dict[str, MessageField]) -> MessageField:
    if word == "unsigned":
        return MessageField("", "u" + BASE[tokens.next()])
    if word in BASE:
        return MessageField("", BASE[word])
    if word in arrays:
        return arrays[word]
    return MessageField("", word.replace("::", "/"))
