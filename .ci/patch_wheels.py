"""Points the CMake files of the ROS wheels to this interpreter's headers.

The wheels' exported targets name the include folders of the machine that built them; a package that is compiled against
them needs the folders of the Python and numpy that are installed here.
"""

from __future__ import annotations

import re
import sys
import sysconfig
from pathlib import Path

import numpy as np

BUILDER = r"/opt/python/cp3\d+-cp3\d+"


def patched(text: str, python_include: str, numpy_include: str) -> str:
    """Returns the CMake code with the builder's two include folders replaced.

    Args:
        text: Contents of an exported CMake file.
        python_include: Folder that holds Python.h.
        numpy_include: Folder that holds numpy/ndarrayobject.h.
    """
    text = re.sub(BUILDER + r"/lib/python3\.\d+/site-packages/numpy/_core/include", lambda _: numpy_include, text)
    return re.sub(BUILDER + r"/include/python3\.\d+", lambda _: python_include, text)


def main(prefix: Path) -> None:
    """Rewrites every CMake file below `prefix`/share that names the builder's folders."""
    python_include, numpy_include = sysconfig.get_path("include"), np.get_include()
    for path in sorted(prefix.glob("share/**/*.cmake")):
        before = path.read_text(encoding="utf-8")
        after = patched(before, python_include, numpy_include)
        if after != before:
            path.write_text(after, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
