"""The page on the library: mkdocstrings fills in the docstrings of every public name."""

from __future__ import annotations

import calibration_core
from calibration_core import __all__ as public

HEAD = """# Library

```python
import calibration_core as cal

cell = cal.load_cell("config/cells/small.cell.yaml")
recording = cal.load_recording("bags/small_loaded", cell)
result = cal.identify(recording)
print(result.summary)
result.save("identified", report=False)
```

What stands on this page is the library; everything else in the package may change without notice. Every result has
`summary`, `tables`, `to_dataframe()` (with pandas installed), `plot()`, `to_dict()` and `save()`, and shows itself in
a notebook. Values are in SI units. Errors of the input are `InputError`, with the same one line as the command's.
"""


def page() -> str:
    """Return the page, Markdown with directives of mkdocstrings: functions first, then what they return."""
    names = sorted(public, key=lambda name: (not name[0].islower(), name))
    return "\n".join([HEAD, *(f"## {name}\n\n::: {_home(name)}\n" for name in names)])


def _home(name: str) -> str:
    value = getattr(calibration_core, name)
    return f"{value.__module__}.{value.__qualname__}"
