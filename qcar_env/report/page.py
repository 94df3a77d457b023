"""Write a report as one HTML file: style, scripts, plotly and data inside, no network needed."""

from __future__ import annotations

import base64
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, select_autoescape
from numpy.typing import NDArray
from plotly.offline import get_plotlyjs  # pyright: ignore[reportMissingTypeStubs, reportUnknownVariableType]

from qcar_env.evaluation import storage
from qcar_env.report.content import Cell, Chart, Column, Curve, History, Report


def write(path: Path, report: Report) -> Path:
    """Write the page, whole or not at all, and return where.

    Parameters
    ----------
    path : Path
        File to write, ending in .html.
    report : Report
        What it shows.
    """
    storage.write_text(path, render(report))
    return path


def render(report: Report) -> str:
    """Return the page."""
    templates = Environment(
        loader=PackageLoader("qcar_env.report"),
        autoescape=select_autoescape(["html"]),
        trim_blocks=True,
        lstrip_blocks=True,
    )
    templates.filters |= {"cell": cell, "key": sort_key}
    data = {
        "unit": report.force_unit.replace("^2", "²"),
        "charts": [specification(each) for each in report.charts],
        "histories": [_packed(each) for each in report.histories],
    }
    source = templates.loader
    assert source is not None
    return templates.get_template("report.html").render(
        report=report,
        groups=list(dict.fromkeys(each.group for each in report.histories)),
        labels=list(dict.fromkeys((each.label, each.colour) for each in report.histories)),
        shown=set(report.shown or [each.label for each in report.histories]),
        style=source.get_source(templates, "report.css")[0],
        script=source.get_source(templates, "report.js")[0],
        plotly=get_plotlyjs(),
        # "</" and "<!--<script>" would change where the element that holds the data ends.
        data=json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"),
    )


def cell(value: Cell, column: Column) -> str:
    """Return a cell's text: numbers with the column's digits, a dash where there is none."""
    if value is None:
        return "–"
    if isinstance(value, str):
        return value
    if not math.isfinite(value):
        return "∞" if value > 0 else "–"
    if column.exact:
        return f"{value:.{column.digits}g}"
    if float(value).is_integer() and abs(value) < 1e6:
        return f"{value:.0f}"
    if 1e-4 <= abs(value) < 1e6:
        places = max(0, column.digits - 1 - math.floor(math.log10(abs(value))))
        return f"{value:.{places}f}"
    return f"{value:.{column.digits - 1}e}"


def sort_key(value: Cell) -> str:
    """Return what the page sorts a cell by."""
    if value is None:
        return ""
    return value if isinstance(value, str) else repr(float(value))


def specification(chart: Chart) -> dict[str, Any]:
    """Return a chart in the words of plotly; the page adds its theme's colours."""
    traces: list[dict[str, Any]] = []
    for number, curve in enumerate(chart.curves):
        if curve.low is not None and curve.high is not None:
            traces += _interval(curve, number)
        trace: dict[str, Any] = {
            "type": "scatter",
            "mode": curve.mode,
            "name": curve.label,
            "legendgroup": str(number),
            "x": _numbers(curve.x),
            "y": _numbers(curve.y),
        }
        if "lines" in curve.mode:
            trace["line"] = {"color": curve.colour, "dash": curve.dash, "width": 2}
        if "markers" in curve.mode:
            trace["marker"] = {"color": curve.colour, "size": 9}
        traces.append(trace)
    scale = {True: "log", False: "linear"}
    return {
        "data": traces,
        "layout": {
            "xaxis": {"title": {"text": chart.x_label}, "type": scale[chart.logarithmic_x]},
            "yaxis": {"title": {"text": chart.y_label}, "type": scale[chart.logarithmic]},
        },
    }


def _interval(curve: Curve, number: int) -> list[dict[str, Any]]:
    assert curve.low is not None
    assert curve.high is not None
    edge = {
        "type": "scatter",
        "mode": "lines",
        "legendgroup": str(number),
        "showlegend": False,
        "hoverinfo": "skip",
        "line": {"width": 0, "color": curve.colour},
        "x": _numbers(curve.x),
    }
    fill = {"fill": "tonexty", "fillcolor": _transparent(curve.colour)}
    return [{**edge, "y": _numbers(curve.low)}, {**edge, **fill, "y": _numbers(curve.high)}]


def _transparent(colour: str) -> str:
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},0.18)"


def _numbers(values: NDArray[Any]) -> list[float | None]:
    return [
        float(f"{value:.6g}") if math.isfinite(value) else None
        for value in np.asarray(values, dtype=np.float64).ravel().tolist()
    ]


def _packed(history: History) -> dict[str, Any]:
    return {
        name: _array(value) if isinstance(value, np.ndarray) else value
        for name, value in vars(history).items()
    }


def _array(values: NDArray[Any]) -> dict[str, Any]:
    """Pack an array as little-endian 32-bit floats: 7 digits, a sixth of the size of text."""
    packed = base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes())
    return {"shape": list(values.shape), "data": packed.decode("ascii")}
