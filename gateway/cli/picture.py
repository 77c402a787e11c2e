"""The robot from above as a picture file: SVG from the standard library, PNG by Matplotlib."""

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Final
from xml.etree import ElementTree as Xml

from gateway.chassis.contract import Chassis
from gateway.setup.picture import STYLES, Mark, Sheet, Style, Words, from_above

FONT: Final = "DejaVu Sans, Verdana, Arial, sans-serif"
_SVG: Final = "http://www.w3.org/2000/svg"


def svg(sheet: Sheet) -> str:
    """As text, the same for the same sheet; what is about a motor or an axis has its name as `data-of`."""
    width, height = f"{sheet.width:g}", f"{sheet.height:g}"
    look = {"xmlns": _SVG, "viewBox": f"0 0 {width} {height}", "width": width, "height": height}
    root = Xml.Element("svg", look | {"role": "img", "font-family": FONT})
    Xml.SubElement(root, "title").text = sheet.title
    Xml.SubElement(root, "desc").text = sheet.says
    for mark in sheet.marks:
        _draw(root, mark)
    for words in sheet.words:
        _write(root, words)
    Xml.indent(root)
    return Xml.tostring(root, encoding="unicode") + "\n"


def _draw(root: Xml.Element, mark: Mark) -> None:
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in mark.points)
    about = {"class": mark.style} | ({"data-of": mark.of} if mark.of else {})
    Xml.SubElement(root, "polygon" if mark.closed else "polyline", about | _look(STYLES[mark.style]), points=points)


def _look(style: Style) -> dict[str, str]:
    found = {"fill": style.fill or "none"}
    if style.stroke:
        found |= {"stroke": style.stroke, "stroke-width": f"{style.width:g}"}
    if style.dash:
        found["stroke-dasharray"] = " ".join(f"{part:g}" for part in style.dash)
    return found


def _write(root: Xml.Element, words: Words) -> None:
    look = {"font-size": f"{words.size:g}"}
    look |= {"font-weight": "bold"} if words.strong else {}
    look |= {"text-anchor": "middle"} if words.middle else {}
    text = Xml.SubElement(root, "text", look, x=f"{words.at[0]:.1f}", y=f"{words.at[1]:.1f}")
    text.text = words.text


def _svg_file(sheet: Sheet, path: Path) -> None:
    path.write_text(svg(sheet), encoding="utf-8")


def _png_file(sheet: Sheet, path: Path) -> None:
    import_module("gateway.cli.picture_png").draw(sheet, path)  # Matplotlib takes half a second to import


_FORMS: Final[dict[str, Callable[[Sheet, Path], None]]] = {".svg": _svg_file, ".png": _png_file}


def draw(robot: Chassis, path: Path) -> None:
    """In the form of the file's ending, .svg or .png. Raises OSError, GeometryError."""
    _FORMS[path.suffix.lower()](from_above(robot), path)
