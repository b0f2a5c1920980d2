"""What the library's functions are called with: every argument is held against its annotation, in one place.

A value of another kind, or none of the choices, is an `InputError` in one line, as it is on the command line.
"""

from __future__ import annotations

import collections.abc
import dataclasses
import functools
import inspect
import math
import numbers
import os
import types
import typing
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, ParamSpec, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from calibration_core.errors import InputError, quoted

P = ParamSpec("P")
R = TypeVar("R")
PLAIN = (bool, int, float, str, bytes, tuple, list, Path, type(None))  # what a message quotes
WORDS = {
    "Cell": "a cell (load_cell reads one)",
    "Recording": "a recording (load_recording reads one)",
    "HoldsModel": "the result of identify or diagnose",
    "PlanResult": "the result of plan",
    "ColumnsByName": "a data frame",
    "datetime": "a datetime",
}


class _UnfitError(Exception):
    """A value is none of the kind."""


@dataclasses.dataclass(frozen=True)
class ArgumentKind:
    """A kind of values that no type alone states.

    Attributes:
        words: What it is called in messages.
        taken: Returns a value as the function takes it; raises ValueError, TypeError or OverflowError for any other.
    """

    words: str
    taken: Callable[[Any], Any]


def _number(value: Any) -> float:
    if isinstance(value, bool | np.bool_) or not isinstance(value, numbers.Real) or not math.isfinite(value):
        raise TypeError
    return float(value)


def _integer(value: Any) -> int:
    if isinstance(value, bool | np.bool_) or not isinstance(value, numbers.Integral):
        raise TypeError
    return int(value)


def _seed(value: Any) -> int:
    if _integer(value) < 0:
        raise ValueError
    return int(value)


def _boolean(value: Any) -> bool:
    if not isinstance(value, bool | np.bool_):
        raise TypeError
    return bool(value)


def _path(value: Any) -> Any:
    if not isinstance(value, str | os.PathLike) or not str(value) or "\0" in str(value):
        raise TypeError
    return value if isinstance(value, str) else Path(value)


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError
    return value


def _array(value: Any) -> Any:
    return np.asarray(value, dtype=np.float64)


KINDS: Mapping[Any, ArgumentKind] = {
    float: ArgumentKind("a finite number", _number),
    int: ArgumentKind("a whole number", _integer),
    bool: ArgumentKind("True or False", _boolean),
    Path: ArgumentKind("a path", _path),
    str: ArgumentKind("a text", _text),
}
Seed = Annotated[int, ArgumentKind("a whole number of at least 0", _seed)]
Numbers = Annotated[ArrayLike, ArgumentKind("numbers", _array)]


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """Hold the arguments of a function against their annotations before it is called.

    Raises:
        InputError: By the function that comes back: an argument is of another kind, or none of its choices.
    """
    signature = inspect.signature(function)
    name = function.__name__

    @functools.wraps(function)
    def guarded(*args: P.args, **kwargs: P.kwargs) -> R:
        bound = signature.bind(*args, **kwargs)
        hints = _hints(function)
        for key, value in bound.arguments.items():
            several = signature.parameters[key].kind is inspect.Parameter.VAR_POSITIONAL
            taken = tuple(_taken(name, key, one, hints[key]) for one in (value if several else (value,)))
            bound.arguments[key] = taken if several else taken[0]
        return function(*bound.args, **bound.kwargs)

    return guarded


def differing(values: Mapping[str, Any], defaults: Callable[..., Any], options: Mapping[str, str]) -> frozenset[str]:
    """Return the command's names of those arguments that are not what the function takes for them by itself.

    Args:
        values: Argument -> value.
        defaults: The function.
        options: Argument -> name of the option, where the command has one.
    """
    parameters = inspect.signature(defaults).parameters
    return frozenset(
        options[key] for key, value in values.items() if key in options and value != parameters[key].default
    )


@functools.cache
def _hints(function: Callable[..., Any]) -> dict[str, Any]:
    return typing.get_type_hints(function, include_extras=True)


def _taken(function: str, name: str, value: Any, hint: Any) -> Any:
    try:
        return _as(value, hint)
    except _UnfitError:
        found = quoted(value) if isinstance(value, PLAIN) else f"a value of type {type(value).__name__}"
        raise InputError(function, name, found, _in_words(hint)) from None


def _as(value: Any, hint: Any) -> Any:
    """Return a value as its annotation has it.

    Raises:
        _UnfitError: It is none such.
    """
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    kind = (
        next((one for one in inner[1:] if isinstance(one, ArgumentKind)), None)
        if origin is Annotated
        else KINDS.get(hint)
    )
    if kind is not None:
        try:
            return kind.taken(value)
        except (TypeError, ValueError, OverflowError):
            raise _UnfitError from None
    if origin in {typing.Union, types.UnionType}:
        return _any_of(value, inner)
    if origin is Literal:
        fits = isinstance(value, str) and value in inner
    elif origin is tuple:
        fits = isinstance(value, tuple | list) and len(value) == len(inner)
        value = tuple(_as(one, of) for one, of in zip(value, inner, strict=True)) if fits else value
    elif origin in {collections.abc.Sequence, collections.abc.Iterable}:
        fits = isinstance(value, collections.abc.Iterable) and not isinstance(value, str | bytes | Mapping)
        value = tuple(_as(one, inner[0]) for one in value) if fits else value
    else:
        fits = isinstance(value, hint if origin is None else origin)
    if not fits:
        raise _UnfitError
    return value


def _any_of(value: Any, hints: Collection[Any]) -> Any:
    for hint in hints:
        if hint is str and Path in hints:  # a text is a path there, and an empty one is none
            continue
        try:
            return _as(value, hint)
        except _UnfitError:
            continue
    raise _UnfitError


def _in_words(hint: Any) -> str:
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin is Annotated:
        return next(one.words for one in inner if isinstance(one, ArgumentKind))
    if origin in {typing.Union, types.UnionType}:
        return " or ".join(_in_words(one) for one in inner if not (one is str and Path in inner))
    if origin is Literal:
        return f"one of {', '.join(inner)}"
    if origin is tuple:
        return f"({', '.join(_in_words(one) for one in inner)})"
    if origin in {collections.abc.Sequence, collections.abc.Iterable}:
        return f"several, each {_in_words(inner[0])}"
    if origin is collections.abc.Mapping:
        return "a mapping of arrays"
    if hint is type(None):
        return "None"
    return KINDS[hint].words if hint in KINDS else WORDS[hint.__name__]
