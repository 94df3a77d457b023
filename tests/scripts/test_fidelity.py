"""The fidelity report on the site is what the command writes."""

import re
from pathlib import Path

import pytest

from qcar_env.commands import fidelity

PAGE = Path(__file__).parents[2] / "docs" / "fidelity.md"


NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")
FLAT = "How the preset was calibrated"  # its fits end elsewhere along flat directions


@pytest.mark.slow
def test_the_page_is_up_to_date(tmp_path):
    """But for last digits, which may round another way on another machine."""
    out = tmp_path / "docs" / "page.md"
    assert fidelity.main(["--out", str(out)]) == 0
    pages = [path.read_text("utf-8").split("\n## ") for path in (out, PAGE)]
    for new, old in zip(*pages, strict=True):
        assert NUMBER.sub("#", new) == NUMBER.sub("#", old)
        for one, other in zip(NUMBER.findall(new), NUMBER.findall(old), strict=True):
            last = 10.0 ** -len(other.partition(".")[2])
            assert old.startswith(FLAT) or abs(float(one) - float(other)) < 1.1 * last


def test_the_page_has_every_part():
    text = PAGE.read_text(encoding="utf-8")
    for title in (
        "Table 1, cell by cell",
        "How the preset was calibrated, and how flat the fit is",
        "Trends of section 5.2, row by row",
        "Claims",
        "Errata of the printed paper",
        "What the paper leaves unstated",
    ):
        assert f"\n## {title}\n" in text
    trends = text.split("## Trends")[1].split("\n## ")[0]
    assert len(re.findall(r"^\| Fig\. ", trends, flags=re.MULTILINE)) == 35
    table = text.split("## Table 1")[1].split("\n## ")[0]
    assert len(re.findall(r"\| x[12] \|", table)) == 12
