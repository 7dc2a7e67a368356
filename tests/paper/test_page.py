"""The report page: whole in itself, well-formed, escaped, and readable in a browser at phone width."""

from __future__ import annotations

import base64
import io
import itertools
import json
import re
import shutil
import subprocess
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from mvla_sim.errors import DataError
from mvla_sim.paper.page import Section, table_html, write_page
from mvla_sim.paper.report import write_report

PICTURES = 2 * (4 + 2 * 3)  # a reading: maps of the average and three targets, two sets of curves at three SNRs
VOID = {"meta", "img", "br", "hr", "link", "input"}
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


class Reader(HTMLParser):
    """Checks that tags balance, and collects pictures and what the page would load."""

    def __init__(self):
        super().__init__()
        self.open, self.images, self.loads = [], [], []

    def handle_starttag(self, tag, attributes):
        found = dict(attributes)
        if tag not in VOID:
            self.open.append(tag)
        if tag == "img":
            self.images.append(found)
        self.loads += [v for k, v in found.items() if k in ("src", "href") and not v.startswith("data:")]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def read(path):
    reader = Reader()
    reader.feed(path.read_text(encoding="utf-8"))
    assert reader.open == []
    return reader


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """A small folder of results with made-up numbers."""
    folder = tmp_path_factory.mktemp("results")
    star = pd.DataFrame(
        itertools.product((0.0, 10.0, 20.0), (0, 1), (1.0, 5.0, 10.0, 30.0), ("mvla-gr", "bp")),
        columns=["snr_db", "seed", "interval_deg", "method"],
    )
    star = star.assign(
        scene="star", status="done", case=range(len(star)), key=[f"k{n}" for n in range(len(star))], error="",
        cd_db=-25 + star["interval_deg"] * 0.7 - 3 * (star["method"] == "mvla-gr") + 0.1 * star["seed"],
        top_percent=1.0, min_support_deg=20 + star["snr_db"], area_m2=2.0,
    )  # fmt: skip
    maps = pd.DataFrame(
        itertools.product(("circle", "square", "triangle"), (0.3, 0.5), (0.0, 0.04)), columns=["scene", "kappa", "eta"]
    )
    maps = maps.assign(status="done", case=range(len(maps)), key="k", error="", cd_db=-20 - maps["kappa"] - maps["eta"])
    for reading, (name, table) in itertools.product(
        ("physical", "paper"),
        (
            ("star-optimal", star),
            ("star-calibrated", star.assign(cd_db=star["cd_db"] + 1)),
            ("kappa-eta", maps),
        ),
    ):
        place = folder / reading / name
        place.mkdir(parents=True)
        table.assign(cd_db=table["cd_db"] + (reading == "physical")).to_csv(place / "table.csv", index=False)
        (place / "experiment.json").write_text(json.dumps({"settings": {"name": "<script>alert(1)</script>"}}))
    (folder / "checks.json").write_text(json.dumps({"c16": {"largest_score_change": {"bp": 1e-8}}}))
    (folder / "run.json").write_text(json.dumps({"seconds": {"main": 3.0}, "total_s": 3.0}))
    return folder


@pytest.fixture(scope="module")
def page(results):
    """Their report."""
    return write_report(results)


def test_report_is_whole_in_itself(results, page):
    reader = read(page)
    assert reader.loads == []
    assert len(reader.images) == PICTURES
    for image in reader.images:
        assert image["alt"]
        assert base64.b64decode(image["src"].removeprefix("data:image/png;base64,")).startswith(b"\x89PNG")
    text = page.read_text(encoding="utf-8")
    assert "http" not in text
    assert "<script" not in text
    assert "&lt;script&gt;" in text
    assert text.count("Not run.") == 2  # the examples, the vehicle
    claims = pd.read_csv(results / "claims.csv")
    assert claims["number"].tolist() == 2 * [f"C{n}" for n in range(1, 17)]
    for reading in ("paper", "physical"):
        assert set(pd.read_csv(results / reading / "thresholds.csv")["snr_db"]) == {0.0, 10.0, 20.0}


def test_readings_stand_side_by_side_the_papers_first(results, page):
    claims = pd.read_csv(results / "claims.csv")
    assert claims["reading"].unique().tolist() == ["paper", "physical"]
    text = page.read_text(encoding="utf-8")
    heads = re.findall('<th scope="col">([^<]*)</th>', text)
    assert heads[:4] == ["claim", "the paper says", "&#x27;paper&#x27;", "measured under &#x27;paper&#x27;"]
    assert heads[4] == "&#x27;physical&#x27;"
    assert "<b>−24.4 / −21.4 dB</b>" in text  # of the paper's reading
    assert "<b>−23.4 / −20.4 dB</b>" in text  # of the other, which is 1 dB worse
    assert text.count("<caption>Reading &#x27;") == 2


def test_same_results_give_the_same_page(results, page):
    first = page.read_bytes()
    assert write_report(results).read_bytes() == first


def test_folder_without_results_is_refused(tmp_path):
    with pytest.raises(DataError, match="holds no table"):
        write_report(tmp_path)


@pytest.mark.parametrize("content", ["case,key,status\n0,a,done\n", "case,key,status,cd_db,method\n0,a,failed,,bp\n"])
def test_tables_without_a_usable_case_count_as_not_run(results, tmp_path, content):
    """An experiment that was stopped, or of which every case failed, must not keep the others from being shown."""
    shutil.copytree(results / "paper" / "kappa-eta", tmp_path / "paper" / "kappa-eta")
    (tmp_path / "paper" / "star-optimal").mkdir()
    (tmp_path / "paper" / "star-optimal" / "table.csv").write_text(content)
    text = write_report(tmp_path).read_text(encoding="utf-8")
    assert text.count("Not run.") == 5
    claims = pd.read_csv(tmp_path / "claims.csv").set_index("number")["verdict"]
    assert claims["C3"] == "not tested"
    assert claims["C1"] != "not tested"


def test_a_processed_vehicle_is_shown_and_judged(results, tmp_path):
    shutil.copytree(results / "paper" / "kappa-eta", tmp_path / "all" / "paper" / "kappa-eta")
    vehicle = tmp_path / "all" / "vehicle"
    vehicle.mkdir()
    figures = {f"{who}_{what}": value for who in ("result", "target") for what, value in
               (("length_m", 4.25), ("width_m", 1.75), ("aspect", 2.43), ("orientation_deg", 0.5))}  # fmt: skip
    scores = {"orientation_error_deg": 0.0, "accuracy_m": 0.042, "completeness_m": 0.081, "cd_db": -18.4}
    (vehicle / "result.json").write_text(json.dumps(figures | scores))
    text = write_report(tmp_path / "all").read_text(encoding="utf-8")
    assert "result to outline 4.2 cm" in text
    assert "4.25 × 1.75 m for 4.25 × 1.75 m" in text
    claims = pd.read_csv(tmp_path / "all" / "claims.csv").set_index("number")
    assert claims.loc["C14", "verdict"] == "holds"


def test_failed_and_missing_cases_are_named_on_top_and_in_the_claims(results, page, tmp_path):
    shutil.copytree(results / "paper" / "star-optimal", tmp_path / "r" / "paper" / "star-optimal")
    file = tmp_path / "r" / "paper" / "star-optimal" / "table.csv"
    table = pd.read_csv(file, dtype={"error": str, "status": str})
    table.loc[table["seed"] == 1, ["status", "cd_db"]] = ["missing", float("nan")]
    table.loc[0, ["status", "error", "cd_db"]] = ["failed", "DataError: no <peak>", float("nan")]
    table.to_csv(file, index=False)
    text = write_report(tmp_path / "r").read_text(encoding="utf-8")
    half = len(table) // 2
    assert (
        f"paper/star-optimal: {half + 1} of {len(table)} cases failed or are missing (DataError: no &lt;peak&gt;)"
        in text
    )
    claims = pd.read_csv(tmp_path / "r" / "claims.csv").set_index(["reading", "number"]).loc["paper"]
    assert claims.loc["C3", "verdict"] == "not tested"  # one condition has no case left
    assert f"(1 failed, {half} missing)" in claims.loc["C3", "detail"]
    assert "Not finished" not in page.read_text(encoding="utf-8")


def test_key_figures_are_those_of_the_tables(results, page):
    text = page.read_text(encoding="utf-8")
    claims = pd.read_csv(results / "claims.csv")
    for reading, part in claims[claims["verdict"] != "not tested"].groupby("reading"):
        held = (part["verdict"] == "holds").sum()
        assert f"<b>{held} of {len(part)}</b>claims of the paper that could be tested hold under the reading" in text
        assert f"under the reading &#x27;{reading}&#x27;" in text
    assert "<b>−24.4 / −21.4 dB</b>mean CD of MVLA-GR / BP at 5° and 20 dB" in text  # −25 + 3.5 + 0.05 (− 3)


def test_tables_of_sentences_name_their_cells_for_phones():
    text = table_html(pd.DataFrame({'say "so"': ["a"]}), stack=True)
    assert '<table class="stack">' in text
    assert 'data-label="say &quot;so&quot;"' in text


def test_cells_are_escaped_and_verdicts_are_words():
    text = table_html(pd.DataFrame({"a<b": ["<i>", "holds"], "n": [1.23456, float("nan")]}))
    assert "a&lt;b" in text
    assert "&lt;i&gt;" in text
    assert "✓ holds" in text
    assert "1.235" in text
    assert "nan" not in text


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine; Debian has it in its package chromium")
@pytest.mark.slow
def test_a_browser_shows_the_report_at_phone_width(page, tmp_path):
    """No error in the console, every picture loads, and nothing scrolls sideways at 380 px."""
    text = page.read_text(encoding="utf-8")
    assert "<script" not in text
    (tmp_path / "probe.html").write_text(
        '<!DOCTYPE html><meta charset="utf-8"><style>iframe { border: 0; width: 380px }</style><body><script>'
        "window.onerror = e => console.error(e); const frame = document.createElement('iframe');"
        f"frame.srcdoc = new TextDecoder().decode(Uint8Array.from(atob('{base64.b64encode(text.encode()).decode()}'), "
        "c => c.charCodeAt(0))); frame.onload = () => { const inner = frame.contentDocument;"
        "document.title = JSON.stringify({width: inner.documentElement.scrollWidth, seen: frame.clientWidth,"
        "images: [...inner.images].map(i => i.complete && i.naturalWidth)}); }; document.body.append(frame);</script>",
        encoding="utf-8",
    )
    flags = [
        "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
        "--disable-background-networking", "--disable-component-update", "--enable-logging=stderr",
        "--virtual-time-budget=5000", "--dump-dom",
    ]  # fmt: skip
    done = subprocess.run(
        [CHROMIUM, *flags, f"--user-data-dir={tmp_path / 'profile'}", (tmp_path / "probe.html").as_uri()],
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    found = re.search(r"<title>(\{.*?\})</title>", done.stdout)
    assert found, done.stdout[-500:]
    measured = json.loads(found.group(1).replace("&quot;", '"'))
    assert measured["seen"] == 380
    assert measured["width"] <= 380
    assert len(measured["images"]) == PICTURES
    assert all(width > 0 for width in measured["images"])
    assert "CONSOLE" not in done.stderr


def test_pictures_are_part_of_the_page(tmp_path):
    """In few colours: a smooth picture takes a fraction of its own size, and no colour is far from what it was."""
    x = np.tile(np.linspace(0, 255, 200), (150, 1))
    noise = np.random.default_rng(0).integers(0, 4, (150, 200, 3))
    pixels = (np.clip(np.stack([x, 255 - x, 0.3 * x], -1), 0, 251) + noise).astype(np.uint8)
    picture = tmp_path / "one.png"
    Image.fromarray(pixels).save(picture)
    size = picture.stat().st_size
    page = write_page(tmp_path / "p.html", "T & T", "lead", [Section("S", figures=[(picture, 'a "quoted" caption')])])
    picture.unlink()
    reader = read(page)
    assert reader.images[0]["alt"] == 'a "quoted" caption'
    embedded = base64.b64decode(reader.images[0]["src"].removeprefix("data:image/png;base64,"))
    assert len(embedded) < 0.7 * size
    shown = np.asarray(Image.open(io.BytesIO(embedded)).convert("RGB"), int)
    assert shown.shape == pixels.shape
    assert np.abs(shown - pixels).mean() < 4
