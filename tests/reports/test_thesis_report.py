"""The report on the thesis: the committed text, what the command makes of it, its frequency responses."""

import re
import struct
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter
from typer.testing import CliRunner

from reports.__main__ import app
from reports.thesis import flow, report
from reports.thesis.report import EXPERIMENTS, anchor
from reports.thesis.response import LOW
from reports.thesis.runs import empirical_response, fit_output_error, held_input, response_at, velocity

COMMITTED = Path(__file__).parents[2] / "reports" / "thesis.md"
QUICK = (flow.bulk_modulus, flow.transfer_function)


def table_rows(text: str) -> list[list[str]]:
    return [[c.strip() for c in line.strip("|").split("|")] for line in text.splitlines() if line[:2] == "| "]


def test_each_row_has_a_verdict_and_each_failure_a_reason():
    text = COMMITTED.read_text("utf-8")
    _, *sections = re.split(r"^## \d+\. ", text, flags=re.M)
    assert len(sections) == len(EXPERIMENTS)
    for one in sections:
        rows = [r for r in table_rows(one) if len(r) == 8 and r[7].startswith("±")]
        assert rows
        for row in rows:
            verdict = row[6].strip("*")
            assert verdict in ("meets", "does not meet")
            if verdict == "does not meet":
                reasons = [x for x in one.splitlines() if x.startswith("- Does not meet") and row[0] in x]
                assert reasons, row[0]


def test_every_link_and_picture_of_the_committed_report_is_there():
    text = COMMITTED.read_text("utf-8")
    pictures = re.findall(r"!\[[^]]*\]\(([^)]+)\)", text)
    assert len(pictures) == len(set(pictures)) == 7
    for name in pictures:
        head = (COMMITTED.parent / name).read_bytes()[:24]
        assert head[:8] == b"\x89PNG\r\n\x1a\n"
        assert 800 <= struct.unpack(">I", head[16:20])[0] <= 1000
    made = {f"thesis/{p.name}" for p in (COMMITTED.parent / "thesis").glob("*.png")}
    assert made == set(pictures)
    headings = {anchor(h) for h in re.findall(r"^## (.+)$", text, flags=re.M)}
    assert set(re.findall(r"\(#([^)]+)\)", text)) <= headings


@pytest.mark.slow
def test_the_committed_report_is_what_the_command_measures(monkeypatch, tmp_path):
    """As far as quick experiments tell; after a change of the plant: ``python -m reports thesis``."""
    monkeypatch.setattr(report, "EXPERIMENTS", QUICK)
    result = CliRunner().invoke(app, ["thesis", "-o", str(tmp_path)])
    assert result.exit_code == 0, result.stderr
    assert "Bulk modulus: 2 of 2 numbers meet" in result.stdout
    made = {p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*.*")}
    assert made == {"thesis.md", "thesis/bulk_modulus.png"}
    committed, again = (
        {(r[0], r[2], r[3]) for r in table_rows(path.read_text("utf-8")) if len(r) == 7}
        for path in (COMMITTED, tmp_path / "thesis.md")
    )
    # The table's head and each section's line of how many meet are of this run.
    numbers = {row for row in again if row[1] and row[0] not in ("what", "---")}
    assert len(numbers) == 18 and numbers <= committed


T = 1e-3


@pytest.fixture(scope="module")
def command() -> np.ndarray:
    rng = np.random.default_rng(5)
    time = np.arange(8000) * T
    return 47.0 * np.sin(2 * np.pi * (0.1 + 60.0 * time / 8.0) * time) + 8.0 * rng.choice([-1.0, 1.0], 8000)


def integrated_output(command: np.ndarray) -> np.ndarray:
    """∫ output of eq. 6.12 by exact discretisation for the held command: no part of the code under test."""
    continuous = np.array(LOW.numerator), np.polymul(LOW.denominator, [1.0, 0.0])
    top, bottom, _ = cont2discrete(continuous, T, method="zoh")
    late = round(LOW.delay / T)
    held = np.concatenate([np.zeros(late), command[: command.size - late]])
    return lfilter(np.ravel(top), bottom, held)


def test_the_thesis_model_is_found_again_with_its_delay(command):
    """From positions of a simulated eq. 6.12, differenced and filtered like a log's."""
    output = velocity(integrated_output(command))
    given = held_input(command)
    fits = {d: fit_output_error(given, output, zeros=2, poles=3, delay=d * T) for d in (9, 10, 11)}
    best = max(fits, key=lambda d: fits[d][1])
    assert best == 10
    model, fit = fits[10]
    assert fit > 0.999
    np.testing.assert_allclose(np.sort_complex(model.poles), np.sort_complex(LOW.poles), rtol=0.01)
    assert model.gain == pytest.approx(LOW.gain, rel=1e-3)
    # 16.77 Hz of eq. 6.12, which the thesis prints as 16.8.
    assert model.bandwidth_hz() == pytest.approx(16.8, abs=0.1)


def test_single_sine_and_etfe_give_the_response(command):
    output = velocity(integrated_output(command))
    frequency, response = empirical_response(held_input(command), output, width_hz=0.5)
    for hz in (5.0, 12.0, 20.0):
        near = int(np.argmin(np.abs(frequency - hz)))
        assert abs(response[near] / LOW.at(hz) - 1.0) < 0.05
        time = np.arange(3000) * T
        sine = np.sin(2 * np.pi * hz * time)
        output = velocity(integrated_output(sine))
        part = slice(1000, 2800)
        single = response_at(held_input(sine)[part], output[part], hz)
        assert abs(single / complex(LOW.at(hz)) - 1.0) < 0.01
