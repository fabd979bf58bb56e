"""The page of all studies: every claim with its verdict, every function that a claim names, nothing from elsewhere."""

from __future__ import annotations

import base64
import pathlib
import re

import pytest

from jaxgeo.studies.all_studies import Study
from jaxgeo.studies.claims import Claim, Verdict
from jaxgeo.studies.page import function_of, study_page, write_page
from jaxgeo.studies.sheet import Sheet

PIXEL = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="
)
CLAIMS = [
    Claim("P", "Eq. 1", "a <sum> & more", 1.0, 1.0, function="jaxgeo.studies.claims.is_within"),
    Claim("P", "Table 1", "a length", 1.0, 2.0, function="jaxgeo.studies.claims.Claim.verdict"),
    Claim("P", "Fig. 1", "a sketch", None, None, reason="it has no numbers"),
]
SHEET = Sheet("lengths", "Lengths", {"name": "", "m": ".2f"}, [["<b>", 1.5], ["two", None]], "In metres.")


@pytest.fixture
def study(tmp_path: pathlib.Path) -> Study:
    (tmp_path / "a_picture.png").write_bytes(PIXEL)
    return Study("paper", "A paper", CLAIMS, [SHEET], [tmp_path / "a_picture.png"])


def test_the_page_has_every_claim_table_picture_and_function(study: Study, tmp_path: pathlib.Path) -> None:
    write_page(tmp_path / "index.html", [study])
    text = (tmp_path / "index.html").read_text(encoding="utf-8")
    claims = text[text.index('<table class="claims">') :]
    rows = re.findall(r'<tr class="(\w+)">\s*<th>(.*?)</th><td>(.*?)</td>', claims, flags=re.DOTALL)
    assert [(kind, item) for kind, item, _ in rows] == [
        ("reproduced", "Eq. 1"),
        ("unexplained", "Table 1"),
        ("not_from_print", "Fig. 1"),
    ]
    assert rows[0][2] == "a &lt;sum&gt; &amp; more"
    assert "it has no numbers" in rows[2][2]
    targets = set(re.findall(r'href="#([^"]+)"', text))
    assert targets <= set(re.findall(r'id="([^"]+)"', text))
    assert {"paper", "functions", "jaxgeo.studies.claims.is_within", "jaxgeo.studies.claims.Claim.verdict"} <= targets
    assert "jaxgeo/studies/claims.py:" in text
    assert '<td class="">&lt;b&gt;</td>' in text
    assert base64.b64encode(PIXEL).decode() in text
    assert not re.search(r"(src|href)=\"(https?:|//)|url\(", text)


def test_counts_of_each_verdict(study: Study) -> None:
    assert dict(study.counts) == {
        Verdict.reproduced: 1,
        Verdict.explained: 0,
        Verdict.unexplained: 1,
        Verdict.not_from_print: 1,
    }
    row = re.search(r'<tr class="total">(.*?)</tr>', study_page([study, study]), flags=re.DOTALL)
    assert row is not None
    assert re.findall(r"<td>(\d+)</td>", row[1]) == ["2", "0", "2", "2", "6"]


def test_a_function_is_shown_by_its_signature_and_place() -> None:
    found = function_of("jaxgeo.locate")
    assert found.signature.startswith("(sensor")
    assert found.place.startswith("jaxgeo/")
    assert found.doc
    with pytest.raises(ValueError, match="names nothing that can be imported"):
        function_of("jaxgeo.nothing")
