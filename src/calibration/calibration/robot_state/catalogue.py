"""Adapters by name, and how the types of their sources are loaded."""

from __future__ import annotations

import importlib
from typing import Any

from calibration.robot_state import abb, fanuc, industrial, kuka_fri, kuka_kss, manual_confirm, native, staubli, ur
from calibration.robot_state.adapter import Adapter
from calibration_core.errors import InputError, quoted

GENERIC = "generic"
ADAPTERS = {
    module.ADAPTER.name: module.ADAPTER
    for module in (native, industrial, ur, kuka_kss, kuka_fri, abb, fanuc, staubli, manual_confirm)
}
NAMES = (*ADAPTERS, GENERIC)
FROM_SOURCE = {"industrial_msgs", "fanuc_msgs", "kuka_driver_interfaces"}  # not released for Jazzy


def adapter_of(name: str) -> Adapter:
    """Return a ready-made adapter.

    Raises:
        InputError: There is none of this name.
    """
    if name not in ADAPTERS:
        raise InputError("parameters", "robot_state.adapter", quoted(name), f"one of {', '.join(NAMES)}")
    return ADAPTERS[name]


def load_type(text: str) -> Any:
    """Return the class of a message, service or action by its name, `package/msg/Name`.

    Raises:
        InputError: The name is malformed, the package is not installed (and what would install it), or has no such
            type.
    """
    parts = text.split("/")
    if len(parts) != 3 or parts[1] not in {"msg", "srv", "action"} or not all(part.isidentifier() for part in parts):
        raise InputError("parameters", "type", quoted(text), "package/msg/Name")
    package, kind, name = parts
    try:
        module = importlib.import_module(f"{package}.{kind}")
    except ImportError:
        raise InputError(package, text, "no such package", how_to_install(package)) from None
    found = getattr(module, name, None)
    if found is None:
        raise InputError(package, text, "no such type", f"one of {', '.join(_names(module))}")
    return found


def how_to_install(package: str) -> str:
    """Return what has to be done to have a message package."""
    if package in FROM_SOURCE:
        return f"package {package}, built from its source in this workspace or an underlay"
    return f"package {package}: apt install ros-jazzy-{package.replace('_', '-')}, or build it from source"


def _names(module: Any) -> list[str]:
    return sorted(name for name in dir(module) if name[:1].isupper())
