"""yourdfpy, loaded without the import of all of trimesh, which takes three times as long as everything else together.

Reading joints and links needs trimesh's transformations alone.  yourdfpy's other parts, which draw scenes, get the
whole library at their first use.
"""

from __future__ import annotations

import functools
import importlib.util
import sys
import types
from typing import Any


@functools.cache
def yourdfpy() -> Any:
    """Return the module."""
    spec = importlib.util.find_spec("trimesh")
    if "trimesh" in sys.modules or spec is None or spec.loader is None or spec.submodule_search_locations is None:
        return importlib.import_module("yourdfpy")
    package = types.ModuleType("trimesh")  # the real one's folder, without its __init__
    package.__path__ = list(spec.submodule_search_locations)
    package.__getattr__ = lambda _: object  # type: ignore[method-assign]  # names in annotations
    sys.modules["trimesh"] = package
    try:
        loaded = importlib.import_module("yourdfpy")
    finally:
        spec.loader = importlib.util.LazyLoader(spec.loader)
        whole = importlib.util.module_from_spec(spec)
        sys.modules["trimesh"] = whole
        spec.loader.exec_module(whole)
    loaded.urdf.trimesh = whole
    return loaded
