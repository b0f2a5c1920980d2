"""The figures as a browser shows them, held against small pictures of them: one that is broken or empty is noticed.

A figure that is meant to look otherwise: look at the picture that the failing test names, and copy it to `pictures`.
"""

from __future__ import annotations

import base64
from pathlib import Path

import numpy as np
import pytest
from browser import pictured
from matplotlib import image

from calibration_core.report.document import Document
from calibration_core.timeseries import Float2D

PICTURES = Path(__file__).parent / "pictures"
WIDE, HIGH = 640, 480  # pixels of a figure in the browser
BLOCK = 5  # pixels of the browser that are one of the picture: fine differences of browsers are not seen
ALIKE = 0.01  # mean difference of two pictures of the same figure, of 1 for black and white
PLACE = 0.35  # difference of one pixel of them


def seen(document: Document, folder: Path) -> dict[str, Float2D]:
    """Return what a browser shows of the figures, by their keys: grey, 0 to 1."""
    figures = list(document.figures())
    style = f"display:block;width:{WIDE}px;height:{HIGH}px;object-fit:contain"
    images = "".join(
        f'<img style="{style}" src="data:image/svg+xml;base64,{base64.b64encode(figure.svg).decode()}">'
        for figure in figures
    )
    page = folder / "figures.html"
    page.write_text(f"<!DOCTYPE html><body style='margin:0;background:#fff'>{images}</body>", encoding="utf-8")
    whole = image.imread(pictured(page, folder, WIDE, HIGH * len(figures)))[:, :, :3].mean(axis=2)
    assert whole.shape == (HIGH * len(figures), WIDE)
    small = whole.reshape(len(figures), HIGH // BLOCK, BLOCK, WIDE // BLOCK, BLOCK).mean(axis=(2, 4))
    return dict(zip((figure.key for figure in figures), small, strict=True))


def alike(one: Float2D, other: Float2D) -> bool:
    """Tell whether two pictures show the same."""
    difference = np.abs(one - other)
    return bool(difference.mean() <= ALIKE and difference.max() <= PLACE)


@pytest.mark.parametrize("name", ["loaded", "absolute"])
def test_every_figure_looks_as_it_did(name: str, documents: dict[str, Document], tmp_path: Path) -> None:
    found = seen(documents[name], tmp_path)
    assert len(found) >= 3
    changed = []
    for key, picture in found.items():
        kept = PICTURES / f"{name}-{key}.png"
        image.imsave(tmp_path / kept.name, picture, cmap="gray", vmin=0.0, vmax=1.0)
        if not kept.is_file() or not alike(picture, image.imread(kept)[:, :, 0]):
            changed.append(f"{tmp_path / kept.name} instead of {kept}")
    assert changed == []
