"""Drivers' interfaces as their repositories define them (`drivers/index.yaml`), as classes of messages."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from calibration.topics import NO_PACKAGE
from calibration_core.errors import InputError

FOLDER = Path(__file__).with_name("drivers")
ROS_NAMES = {"bool": "boolean", "float32": "float", "float64": "double"}


class Vendored:
    """The message packages of one release of a driver."""

    def __init__(self, folder: Path) -> None:
        self.store = get_typestore(Stores.ROS2_JAZZY)
        self.packages = {path.name for path in folder.iterdir() if path.is_dir()} | {"std_msgs", "builtin_interfaces"}
        self.services = set()
        for path in sorted(folder.rglob("*.[ms][sr][gv]")):
            package, kind, name = path.parts[-3], path.parts[-2], path.stem
            text = path.read_text("utf-8")
            if kind == "srv":
                self.services.add(f"{package}/srv/{name}")
                text, name = text.partition("---\n")[2], f"{name}_Response"
            self.store.register(get_types_from_msg(text, f"{package}/msg/{name}"))

    def __call__(self, name: str) -> Any:
        """Return the class of a type as `rosidl` makes it, as far as tables need it."""
        if name.partition("/")[0] not in self.packages:
            raise InputError(name, "", NO_PACKAGE, "a package of the release")
        if name in self.services:
            return SimpleNamespace(Response=self(name.replace("/srv/", "/msg/") + "_Response"))
        if name not in self.store.types:
            raise InputError(name, "", "no such type", "a type of the release")
        kind = self.store.types[name]
        fields = {field: _named(of) for field, of in self.store.fielddefs[name][1]}
        kind.__name__ = name.rpartition("/")[2]
        kind.get_fields_and_field_types = staticmethod(lambda: fields)
        return kind

    def make(self, name: str, values: Any = ()) -> Any:
        """Return a message, or a service's response: zero, empty or false where nothing is said."""
        values = dict(values)
        kind = self(name)
        name, kind = (f"{name.replace('/srv/', '/msg/')}_Response", kind.Response) if "/srv/" in name else (name, kind)
        return kind(**{field: self._value(of, values.get(field)) for field, of in self.store.fielddefs[name][1]})

    def _value(self, of: Any, value: Any) -> Any:
        sort, detail = of
        if sort is Nodetype.BASE:
            zero = "" if detail[0] == "string" else detail[0] != "bool" and 0
            return zero if value is None else value
        if sort is Nodetype.NAME:
            return self.make(detail, value or ())
        values = [self._value(detail[0], one) for one in value or ()]
        numbers = detail[0][0] is Nodetype.BASE and detail[0][1][0] != "string"
        return np.array(values, detail[0][1][0]) if numbers else values


def _named(of: Any) -> str:
    """Return the type of a field as `get_fields_and_field_types` gives it."""
    sort, detail = of
    if sort is Nodetype.BASE:
        return str(ROS_NAMES.get(detail[0], detail[0]))
    if sort is Nodetype.NAME:
        return str(detail).replace("/msg/", "/")
    return f"sequence<{_named(detail[0])}>" if sort is Nodetype.SEQUENCE else f"{_named(detail[0])}[{detail[1]}]"
