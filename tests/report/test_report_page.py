"""The page as a browser would read it: parsed, its policy checked, its figures decoded."""

import re
import time
from typing import Any

import numpy as np
import pytest
from pages import EVIL, Case, Page, case, decoded, hash_source, unpacked

from fdd.diagnosis.findings import FaultFinding, Trajectories
from fdd.report import render_report
from fdd.report.page import PLOTLY_FILE, PLOTLY_VERSION, write_bundle
from fdd.report.plots import y_range
from fdd.samples import Samples


def trace(figure: dict[str, Any], name: str) -> dict[str, Any]:
    return next(t for t in figure["data"] if t.get("name") == name)


@pytest.fixture(scope="module")
def faulty() -> tuple[Case, str, Page]:
    """A report, to be looked at alone."""
    made = case()
    html = render_report(*made)
    return made, html, Page(html)


@pytest.mark.parametrize(
    ("verdict", "words"),
    [
        ("faulty", "Internal leakage or pump gear wear, since 20.3 s, severity 0.41, 97 % sure"),
        ("healthy", "Healthy: no fault found in 60 s"),
        ("inconclusive", "Inconclusive: no answer is sure enough"),
    ],
)
def test_the_verdict_comes_first(verdict, words):
    text = Page(render_report(*case(verdict))).text.replace("\u00a0", " ")
    body = text[text.index("Diagnosis of") :]
    assert words in text[:400], "in the title"
    assert words in body[:200], "at the top of the page"
    assert body.index(words) < body.index("Measured signals") < body.index("Data quality")
    assert ("It could as well be pump gear wear" in text) == (verdict == "faulty")


def test_everything_that_was_asked_for_is_there(faulty):
    _, _, page = faulty
    wanted = {"probabilities", "statistic", "features"}
    wanted |= {f"estimate-{n}" for n in ("leakage", "bulk_modulus", "coulomb_friction", "viscous_friction")}
    measured = ("position", "pressures", "pump-speed", "motor-current", "oil-temperature")
    wanted |= {f"measured-{name}" for name in measured}
    assert set(page.figures) == wanted and {f"plot-{name}" for name in wanted} <= set(page.attributes("id"))
    for words in (
        "+75 %", "axis_a", "numpy", "false alarms per hour", "Sensors not trusted",
        "missing, since 20.0 s", "Would have been invisible", "below severity 0.07",
        "To confirm it: Block the rod", "10000 samples",
    ):  # fmt: skip
        assert words in page.text
    assert re.search(r"20\d\d-\d\d-\d\d \d\d:\d\d UTC", page.text)
    assert "width=device-width" in "".join(page.attributes("content"))


def test_figures_show_the_samples_in_everyday_units(faulty):
    made, _, page = faulty
    figures = page.figures
    pressure = decoded(trace(figures["measured-pressures"], "difference P₁ − P₂")["y"])
    assert np.nanmax(pressure) == pytest.approx(25.0), "the one-sample spike of 2.5 MPa"
    position = decoded(trace(figures["measured-position"], "measured")["y"])
    assert np.nanmin(position) == pytest.approx(made.samples["position"].min() * 1e3, rel=1e-6)
    speed = decoded(trace(figures["measured-pump-speed"], "measured")["y"])
    assert np.nanmax(speed) == pytest.approx(made.samples["pump_speed"].max() * 9.5492966, rel=1e-6)
    leakage = decoded(trace(figures["estimate-leakage"], "EKF")["y"])
    assert leakage[-1] == pytest.approx(made.trajectories.estimates["ekf"]["leakage"][-1] * 1e12, rel=1e-6)
    assert decoded(trace(figures["estimate-leakage"], "healthy baseline")["y"])[0] == pytest.approx(6.52)
    current = trace(figures["measured-motor-current"], "motor current")
    times = decoded(current["x"])[np.isnan(decoded(current["y"]))]
    assert times.min() == pytest.approx(20.0, abs=0.1), "missing from 20 to 22 s"


def test_what_is_not_observable_is_grey_and_has_no_band(faulty):
    figures = faulty[2].figures
    viscous, leakage = figures["estimate-viscous_friction"], figures["estimate-leakage"]
    coloured = [t["line"]["color"] for t in viscous["data"] if str(t.get("name")).startswith(("EKF", "SVSF"))]
    assert set(coloured) == {"#8A8F98"}
    assert all(decoded(t["y"]).size == 0 for t in viscous["data"] if t.get("fill"))
    shaded = [s for s in viscous["layout"]["shapes"] if s["type"] == "rect"]
    assert (shaded[0]["x0"], shaded[0]["x1"]) == pytest.approx((0.0, 60.0), abs=0.01)
    assert [s for s in leakage["layout"]["shapes"] if s["type"] == "rect"] == []
    bands = [t for t in leakage["data"] if t.get("fill")]
    assert len(bands) == 2
    for drawn in bands:
        time, edge = decoded(drawn["x"]), decoded(drawn["y"])
        assert time.size == edge.size > 100
        assert (np.isfinite(time) == np.isfinite(edge)).all() and np.ptp(time[np.isfinite(time)]) > 59.0


def test_the_last_observable_value_is_drawn_on_and_told():
    made = case()
    name = "coulomb_friction"
    seen = made.trajectories.observable[name]
    last = np.maximum.accumulate(np.where(seen, np.arange(seen.size), 0))
    made.trajectories.held[name] = made.trajectories.estimates["ekf"][name][last]
    estimate = made.diagnosis.estimates[name]
    estimate.observable, estimate.held, estimate.held_std, estimate.age_s = False, 131.5, 2.1, 12.0
    html = render_report(*made)
    figures = Page(html).figures
    shown = trace(figures[f"estimate-{name}"], "last observable value")
    y = decoded(shown["y"])
    assert np.isfinite(y).any() and np.isnan(y).any()
    held = made.trajectories.held[name]
    off = np.abs(y[np.isfinite(y), None] - held[np.isfinite(held)]).min(axis=1)
    assert (off <= 6e-7 * held.max()).all(), "six digits"
    assert "131.5 ± 2.1, 12 s before the end" in html
    assert not any(t.get("name") == "last observable value" for t in figures["estimate-leakage"]["data"])


def test_onset_and_detection_stand_in_every_plot_and_families_of_two_percent_are_drawn():
    def marks(verdict: str, interval: tuple[float, float] | None = None) -> list[list[float]]:
        made = case(verdict)
        for fault in made.diagnosis.faults:
            fault.onset_interval = interval
        figures = Page(render_report(*made)).figures
        lines = {t["name"].lower(): decoded(t["y"]) for t in figures["probabilities"]["data"]}
        for family, p in made.trajectories.probabilities.items():
            if family == "healthy" or p.max() >= 0.02:
                assert lines.pop(family)[-1] == pytest.approx(100.0 * p[-1], abs=1.0)
        assert not lines
        return [[s["x0"] for s in f["layout"]["shapes"] if s["type"] == "line"] for f in figures.values()]

    assert all(found == pytest.approx([19.5, 20.28, 20.88]) for found in marks("faulty", (19.5, 20.5)))
    assert all(found == pytest.approx([20.28, 20.88]) for found in marks("faulty"))
    assert not any(marks("healthy")) and not any(marks("inconclusive"))


def test_nothing_is_fetched_and_the_policy_lets_only_the_pages_own_scripts_run(faulty):
    _, html, page = faulty
    assert page.attributes("src", "href", "action", "data", "srcset", "poster") == []
    assert {"link", "iframe", "object", "embed", "base", "img"}.isdisjoint(tag for tag, _ in page.tags)
    style = html[html.index("<style>") : html.index("</style>")]
    assert "url(" not in style and "@import" not in style
    _, bundle, script = page.scripts
    run = [unpacked(bundle), script.encode()]
    assert b"plotly.js" in run[0][:100]
    assert sorted(page.script_policy().split()) == sorted(hash_source(each) for each in run)
    types = [attrs.get("type") for tag, attrs in page.tags if tag == "script"]
    assert types == ["application/gzip", "application/gzip", None], "data, which no browser runs"


@pytest.mark.parametrize("rows", [60_000, 200_000])
def test_pages_of_a_batch_share_plotly_and_sizes_are_bounded(tmp_path, rows):
    made = case(rows=rows)
    html = render_report(*made, alone=False)
    page = Page(html)
    assert len(html.encode()) < 500_000 and len(page.scripts) == 2
    assert page.script_policy() == f"{hash_source(page.scripts[1].encode())} 'strict-dynamic'"
    write_bundle(tmp_path)
    assert f'"{PLOTLY_FILE}"' in page.scripts[1], "what the script loads is what stands beside the page"
    bundle = (tmp_path / PLOTLY_FILE).read_bytes()
    assert f"v{PLOTLY_VERSION}".encode() in bundle[:200]
    begin = time.perf_counter()
    html = render_report(*made)
    assert rows > 60_000 or time.perf_counter() - begin < 1.0
    alone = Page(html)
    assert len(html.encode()) < 1_500_000
    assert unpacked(alone.scripts[1]) == bundle and alone.figures == page.figures
    drawn = [t["y"] for f in page.figures.values() for t in f["data"] if isinstance(t["y"], dict)]
    assert drawn and all(decoded(y).size <= 6_000 for y in drawn)


def test_text_from_the_log_stays_text():
    made = case(rows=6_000, log=EVIL)
    made.diagnosis.axis = made.diagnosis.unit = EVIL
    made.diagnosis.quality.notes = [EVIL]
    made.diagnosis.faults[0].evidence = [EVIL]
    made.diagnosis.faults[0].ambiguity = ["internal_leakage", EVIL]
    made.diagnosis.faults.append(made.diagnosis.faults[0].model_copy(update={"fault": EVIL}))
    made.diagnosis.probabilities[EVIL] = 0.5
    made.diagnosis.estimates[EVIL] = made.diagnosis.estimates["leakage"]
    made.trajectories.probabilities[EVIL] = made.trajectories.probabilities["leakage"]
    made.trajectories.feature_names[0] = EVIL
    made.trajectories.estimates[EVIL] = made.trajectories.estimates["ekf"]
    made.settings[EVIL] = EVIL
    made.unit.description = EVIL
    plain = Page(render_report(*case(rows=6_000)))
    page = Page(render_report(*made))
    assert {tag for tag, _ in page.tags} == {tag for tag, _ in plain.tags}
    assert len(page.scripts) == 3
    assert not [k for _, attrs in page.tags for k in attrs if k.startswith("on")]
    assert page.text.count(EVIL) >= 8 and "49{{" not in page.text
    assert re.fullmatch(r"[A-Za-z0-9+/=]+", page.scripts[0]), "the figures cannot end their element"
    # In figures, plotly must not see markup either.
    names = [t.get("name", "") for f in page.figures.values() for t in f["data"]]
    assert any("alert" in n for n in names) and not any("<" in n for n in names)


def test_little_or_broken_data_still_makes_a_page():
    made = case("inconclusive", rows=6_000)
    none = np.empty(0)
    empty = Trajectories(
        time=none, estimates={"ekf": {"leakage": none}}, stds={}, observable={}, nis={}, window_time=none,
        feature_names=[], features=np.empty((0, 0)), statistic=none, threshold=float("nan"),
    )  # fmt: skip
    page = Page(render_report(made.diagnosis, empty, Samples([], {}), made.unit, {}))
    assert page.figures == {} and "Inconclusive" in page.text
    t = made.trajectories
    t.features[:, 3] = np.nan
    t.features[2, 4] = np.inf
    t.statistic[:] = np.nan
    t.threshold = float("inf")
    t.probabilities["leakage"][5] = np.nan
    t.estimates["ekf"]["leakage"][:] = np.nan
    t.stds["svsf"]["bulk_modulus"][:] = np.inf
    nowhere = {"onset_s": float("nan"), "detected_s": 3.0}
    unknown = FaultFinding(fault="unknown", family="unknown", ambiguity=[], confidence=0.4, **nowhere)
    made.diagnosis.faults = [unknown]
    page = Page(render_report(made.diagnosis, t, made.samples.rows(0, 1), made.unit, {}))
    assert "statistic" not in page.figures and "measured-position" in page.figures
    assert "since an unknown time" in page.text.replace("\u00a0", " ")


def test_lines_that_lie_close_stand_in_rows_and_trackers_that_say_the_same_are_one():
    made = case()
    one = made.diagnosis.faults[0]
    made.diagnosis.faults = [one, one.model_copy(update={"onset_s": one.onset_s + 0.3})]
    notes = Page(render_report(*made)).figures["measured-position"]["layout"]["annotations"]
    marks = [n for n in notes if n["text"].split()[0] in ("onset", "detected")]
    assert len(marks) == len({(n["xanchor"], n["yshift"]) for n in marks}) == 4
    made = case()

    def drawn() -> list[str]:
        traces = Page(render_report(*made)).figures["estimate-leakage"]["data"]
        return [t["name"] for t in traces if "SVSF" in t.get("name", "") and t.get("showlegend", True)]

    ekf, other = (made.trajectories.estimates[k]["leakage"] for k in ("ekf", "svsf"))
    other[:] = ekf
    assert drawn() == ["EKF and SVSF"]
    other[-200:] *= 2.0
    assert drawn() == ["SVSF where it differs"]


def test_a_leak_that_begins_at_the_very_end_is_within_the_plot():
    line = 6.5 + np.random.default_rng(1).normal(0.0, 0.05, 5000)
    line[-20:] = 8.0
    shown = y_range([line], [line - 0.3, line + 0.3], 6.5)
    assert shown is not None and shown[0] < 6.2 and shown[1] > 8.0
