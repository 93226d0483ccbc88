"""CSV as loggers of all countries write it: one log, many texts, the same samples."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up_logs import refused_log, strokes

from fdd.logs import ChannelMap, read_log
from fdd.logs.formats.text_layout import stamps_to_seconds

SAMPLES = strokes(2500)
CHANNELS = ("time", "position", "pump_angle", "pressure_difference")


def rows(
    separator: str = ",", decimal: str = ".", thousands: str = "", stamps: list[str] | None = None
) -> str:
    """The log's rows; pressures in Pa to a tenth, the rest to nine decimals."""
    signs, out = str.maketrans(",.", f"\0{decimal}"), []
    for k in range(len(SAMPLES)):
        cells = [stamps[k] if stamps else f"{SAMPLES.time[k]:.3f}".translate(signs)]
        cells += [f"{SAMPLES[c][k]:.9f}".translate(signs) for c in ("position", "pump_angle")]
        cells += [f"{SAMPLES['pressure_difference'][k]:,.1f}".translate(signs).replace("\0", thousands)]
        out.append(separator.join(f'"{c}"' if separator in c else c for c in cells))
    return "\n".join(out) + "\n"


def dated(form: str) -> list[str]:
    times = pd.Timestamp("2026-03-04 10:15:00") + pd.to_timedelta(SAMPLES.time, unit="s")
    return [t.strftime(form) for t in times]


HEAD = ",".join(CHANNELS) + "\n"
GERMAN_HEAD = HEAD.replace(",", ";")
GERMAN_HEAD = HEAD.replace(",", ";")
TEXTS: dict[str, tuple[str, str]] = {
    "plain": (HEAD + rows(), "utf-8"),
    "sep= line": ("sep=;\r\n" + GERMAN_HEAD + rows(";", ","), "cp1252"),
    "titles, comments": (
        "Prüfstand 3\nBediener: Müller\n# calibrated\n\n" + GERMAN_HEAD + rows(";", ","), "cp1252",
    ),
    "a row of units": (HEAD + "s,m,rad,Pa\n" + rows(), "utf-8"),
    "units in brackets": (HEAD + "[s],[m],[rad],[Pa]\n" + rows(), "utf-8-sig"),
    "thousands, quoted": (HEAD + rows(",", ".", ","), "utf-8"),
    "thousands, German": (GERMAN_HEAD + rows(";", ",", "."), "utf-8"),
    "thousands, Swiss": (HEAD.replace(",", "\t") + rows("\t", ".", "'"), "utf-8"),
    "German dates": (GERMAN_HEAD + rows(";", ",", "", dated("%d.%m.%Y %H:%M:%S,%f")), "cp1252"),
    "ISO dates, comma": (GERMAN_HEAD + rows(";", ",", "", dated("%Y-%m-%d %H:%M:%S,%f")), "utf-8"),
    "American dates": (HEAD + rows(",", ".", "", dated("%m/%d/%Y %I:%M:%S.%f %p")), "utf-8"),
    "a clock alone": (HEAD + rows(",", ".", "", dated("%H:%M:%S.%f")), "utf-8"),
    "a date with a zone": (HEAD + rows(",", ".", "", dated("%Y-%m-%dT%H:%M:%S.%fZ")), "utf-8"),
    "a separator at the end": (HEAD.replace("\n", ",\n") + rows().replace("\n", ",\n"), "utf-8"),
    "UTF-16": (HEAD.replace(",", "\t") + rows("\t"), "utf-16"),
    "other line ends": ((HEAD + rows()).replace("\n", "\r\n"), "utf-8"),
}  # fmt: skip


@pytest.mark.parametrize("habit", TEXTS)
def test_every_habit_gives_the_same_samples(habit: str, tmp_path: Path) -> None:
    text, encoding = TEXTS[habit]
    (tmp_path / "log.csv").write_bytes(text.encode(encoding))
    log = read_log(tmp_path / "log.csv")
    np.testing.assert_allclose(log.samples.time, SAMPLES.time, atol=1e-6)
    for channel in CHANNELS[1:]:
        atol = 0.051 if channel == "pressure_difference" else 1e-9
        np.testing.assert_allclose(log.samples[channel], SAMPLES[channel], atol=atol, err_msg=channel)
    if "date" in habit or habit == "ISO dates, comma":
        assert log.start_ns == pd.Timestamp("2026-03-04 10:15:00").value


def test_date_and_clock_in_two_columns(tmp_path: Path) -> None:
    text = rows(",", ".", "", dated("%d.%m.%Y,%H:%M:%S.%f")).replace('"', "")
    (tmp_path / "log.csv").write_text("Datum,Uhrzeit,position,pump_angle,pressure_difference\n" + text)
    entries = "".join(f"{c}: {{column: {c}}}\n" for c in CHANNELS[1:])
    log = read_log(tmp_path / "log.csv", ChannelMap.from_yaml(entries + "time: {column: Datum Uhrzeit}"))
    np.testing.assert_allclose(log.samples.time, SAMPLES.time, atol=1e-6)


def test_units_of_a_row_are_taken(tmp_path: Path) -> None:
    text = "time,position,pump_angle,pressure_difference\ns,µm,°,bar\n" + rows()
    (tmp_path / "log.csv").write_bytes(text.encode("cp1252"))
    assert "more than any hydraulic circuit holds" in refused_log(tmp_path / "log.csv")  # 2e5 "bar"


def test_a_bad_cell_is_named_behind_thousands_and_titles(tmp_path: Path) -> None:
    lines = ("Title\n" + GERMAN_HEAD + rows(";", ",", ".")).splitlines()
    lines[1000] = lines[1000].rsplit(";", 1)[0] + ";12,3,4"
    (tmp_path / "log.csv").write_text("\n".join(lines))
    assert "line 1001, column 'pressure_difference': '12,3,4'" in refused_log(tmp_path / "log.csv")


@given(
    st.lists(st.datetimes(pd.Timestamp("1980-01-01"), pd.Timestamp("2060-01-01")), min_size=1, max_size=20),
    st.sampled_from(
        ["%d.%m.%Y %H:%M:%S.%f", "%Y-%m-%dT%H:%M:%S.%f", "%Y/%m/%d %H:%M:%S", "%d.%m.%y %H:%M:%S"]
    ),
)
def test_stamps_against_the_standard_library(stamps: list, form: str) -> None:
    texts = [s.strftime(form) for s in stamps]
    wanted = [datetime.strptime(t, form).replace(tzinfo=UTC).timestamp() for t in texts]
    seconds, start, _ = stamps_to_seconds(texts)
    np.testing.assert_allclose(seconds + start * 1e-9, wanted, atol=2e-6)
