"""A cell in space, drawn by a program of our own: `scene.js`, WebGL without any library, and a picture without it.

`View` is what is drawn; `View.json()` is what `scene.js` reads: the same for the report, `check` and the panel.  All
lengths are m, all angles rad, all poses the twelve numbers of a (3, 4) matrix row by row; z of the base is up.

- `joints`: per joint `name`, `prismatic`, `offset` and `pose`: the frame before it, in the link before (`model.chain`);
  where it mimics another, `mimic`: index of that `joint` in a posture's `q`, `multiplier`, `offset`; `q` has no number
  for it.
- `flange`: pose of the flange in the last link.
- `solids`: bodies of the robot: `link` (0 base, i what joint i carries), `form` (`box`; `cylinder` along z; `sphere`;
  `mesh`), `size` (edges; radius and length; radius; empty), `pose` in the link, for a mesh its number as `mesh`.
- `meshes`: `low` and `step` (m) of a grid, `vertices` and `faces`: three 16 bit unsigned numbers each, little endian,
  base64.
- `postures`: `name` and `q` of what can be chosen; the first is shown.  `bent`, where it is there: the same under its
  load, with deflections enlarged as their arrows are; shown with them.
- `targets`: name -> place in the flange frame.
- `frames`: `name`, `on` (`base` or `flange`), `pose` in it.
- `tracker`: its place in the base frame, or null; beams go from there to the targets.
- `boxes`: `name`, `size`, `pose` in the base frame.
- `places`: name -> places in the base frame, shown at every posture.
- `arrows`: `kind`, `posture` (index), `start`, `vector` (as drawn), base frame.
- `kinds`: of arrows: `name`, `colour` (red, green, blue; 0 to 1), `note` (what the length means), `shown` at first.

In a page, `calibrationScene(element, scene, {words, shown, fixed})` draws into an element and returns null where the
browser has no WebGL, otherwise an object with `select(index)`, `posture(q)`, `arrows([...])`, `targets({...})`,
`scene(scene)`, `paint()` (at once, not with the next frame) and `dispose()`.  `words` replaces texts, for another
language: the keys are those of `TEXTS` in `scene.js`.  The element gets a canvas that is turned by dragging, fingers
and keys, a choice of postures, and a choice of what is shown (of which `shown` holds the first one, by layer), unless
it is `fixed`.  `script()` returns the source of the program; an ES module imports the file for what it does: it sets
`window.calibrationScene`.

Beside what this package exports, which needs no drawing library, `view3d.picture` draws a view as PNG and SVG, and
`view3d.space` makes one of a recording or a plan.
"""

from calibration_core.report.view3d.page import page, script, script_safe
from calibration_core.report.view3d.view import Arrow, Frame, View, cell_view

__all__ = ["Arrow", "Frame", "View", "cell_view", "page", "script", "script_safe"]
