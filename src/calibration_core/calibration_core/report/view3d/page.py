"""A view as a page of its own, and the program that draws it in any page."""

from __future__ import annotations

import html
import json
from importlib import resources
from typing import Any

from calibration_core.report.view3d.view import View


def script() -> str:
    """Return the source of the program that draws (`calibrationScene`); safe inside a script element."""
    return (resources.files(__package__) / "scene.js").read_text(encoding="utf-8")


def script_safe(content: Any) -> str:
    """Return plain data as JSON that is safe inside a script element."""
    text = json.dumps(content, allow_nan=False, separators=(",", ":"), ensure_ascii=True)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def page(view: View) -> bytes:
    """Return a view as one HTML file that needs nothing else."""
    content = view.json()
    title = html.escape(content["name"])
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>html, body {{ margin: 0; height: 100%; font: 16px/1.4 sans-serif; color: #111; background: #fff; }}
#scene {{ height: 100vh; }}</style></head>
<body><main id="scene"></main><noscript>This drawing needs JavaScript.</noscript>
<script type="application/json" id="scene-data">{script_safe(content)}</script>
<script>{script()}</script>
<script>
{{ const place = document.getElementById("scene"), data = document.getElementById("scene-data").textContent;
if (!calibrationScene(place, JSON.parse(data))) {{ place.textContent = "This browser has no WebGL."; }} }}
</script></body></html>
""".encode()
