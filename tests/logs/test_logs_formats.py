"""Files that other projects' own writers make, in every format and habit, are equal after reading."""

import sys
from collections.abc import Callable
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up_logs import refused_log, strokes
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat

from fdd.logs import ChannelMap, read_log
from fdd.logs.formats import open_log
from fdd.logs.formats.text_layout import stamps_to_seconds
from fdd.samples import Samples

SAMPLES = strokes(3000)
FOREIGN = {
    "position": ("s_rod", "mm", 1e-3),
    "pump_speed": ("n_pump", "rpm", np.pi / 30.0),
    "pressure_1": ("p_1", "bar", 1e5),
    "pressure_2": ("p_2", "bar", 1e5),
}
MAP = ChannelMap.from_yaml("\n".join(f"{c}: {{column: {n}, unit: {u}}}" for c, (n, u, _) in FOREIGN.items()))
UNITS = {name: unit for name, unit, _ in FOREIGN.values()}
OIL_T = np.arange(0.0, 3.0, 0.5)


def foreign() -> dict[str, np.ndarray]:
    return {n: SAMPLES[c] / factor for c, (n, _, factor) in FOREIGN.items()}


def hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        group = file.create_group("daq/fast")
        for name, values in foreign().items():
            data = group.create_dataset(name, data=values, compression="gzip", chunks=True)
            data.attrs["unit"] = UNITS[name]
        stamps = group.create_dataset("stamp", data=np.rint(SAMPLES.time * 1e9).astype(np.int64))
        stamps.attrs["units"] = b"ns"
        slow = file.create_group("daq/slow")
        slow["stamp"] = np.rint(OIL_T * 1e9).astype(np.int64)
        slow["oil_temperature"] = 40.0 + OIL_T


def hdf5_compound(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["table"] = frame().to_records(index=False)


def matlab5(path: Path) -> None:
    signals = {n: {"time": SAMPLES.time, "value": v, "unit": "?"} for n, v in foreign().items()}
    savemat(path, {"rec": {**signals, "toil": {"time": OIL_T, "value": 40.0 + OIL_T}}}, do_compression=True)


def matlab73(path: Path) -> None:
    """As MATLAB writes: HDF5 behind a block of its own, every vector a 1 x n matrix, text as numbers."""
    with h5py.File(path, "w", userblock_size=512) as file:
        group = file.create_group("log")
        for name, values in {"t": SAMPLES.time, **foreign()}.items():
            group.create_dataset(name, data=values[:, None].T).attrs["MATLAB_class"] = np.bytes_("double")
        text = group.create_dataset("note", data=np.array([[ord(c)] for c in "rig"], dtype=np.uint16))
        text.attrs["MATLAB_class"] = np.bytes_("char")
    with path.open("r+b") as file_:
        file_.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116))


def tdms(path: Path) -> None:
    about = {"wf_increment": 0.001, "unit_string": "?"}
    with TdmsWriter(path) as writer:
        writer.write_segment([ChannelObject("daq", n, v, properties=about) for n, v in foreign().items()])


def mdf(path: Path, version: str) -> None:
    asammdf = pytest.importorskip("asammdf", reason="MDF files need the extra fdd[mdf]")
    with asammdf.MDF(version=version) as file:
        units = UNITS if version > "4" else dict.fromkeys(UNITS, "")
        file.append([asammdf.Signal(v, SAMPLES.time, name=n, unit=units[n]) for n, v in foreign().items()])
        if version > "4":
            file.append([asammdf.Signal(40.0 + OIL_T, OIL_T, name="oil_temperature", unit="degC")])
        file.save(path, overwrite=True)


def frame() -> pd.DataFrame:
    return pd.DataFrame({"time": SAMPLES.time, **foreign()})


def two_sheets(path: Path) -> None:
    with pd.ExcelWriter(path) as book:
        pd.DataFrame({"about": ["rig 3", "a note"]}).to_excel(book, sheet_name="cover", index=False)
        frame().to_excel(book, sheet_name="data", startrow=4, index=False)


WRITERS: dict[str, tuple[str, Callable[[Path], Any]]] = {
    "HDF5": ("a.h5", hdf5),
    "HDF5, compound": ("b.h5", hdf5_compound),
    "MATLAB 5": ("c.mat", matlab5),
    "MATLAB 5, flat": ("d.mat", lambda p: savemat(p, {"Ts": 0.001, **foreign()})),
    "MATLAB 7.3": ("e.mat", matlab73),
    "TDMS": ("f.tdms", tdms),
    "MDF 4": ("g.mf4", lambda p: mdf(p, "4.10")),
    "MDF 3": ("h.mdf", lambda p: mdf(p, "3.30")),
    "Feather": ("i.feather", lambda p: frame().to_feather(p)),
    "Parquet": ("j.parquet", lambda p: frame().to_parquet(p)),
    "Excel": ("k.xlsx", lambda p: frame().to_excel(p, index=False)),
    "Excel, second sheet, titles": ("l.xlsx", two_sheets),
    "CSV, gzip": ("m.csv.gz", lambda p: frame().to_csv(p, index=False)),
}


@cache
def content_of(kind: str) -> bytes:
    """What its writer makes, once."""
    name, write = WRITERS[kind]
    with TemporaryDirectory() as folder:
        write(Path(folder) / name)
        return (Path(folder) / name).read_bytes()


def file_of(kind: str, folder: Path, share: float = 1.0) -> Path:
    """A file with this share of it."""
    path, content = folder / WRITERS[kind][0], content_of(kind)
    path.write_bytes(content[: int(share * len(content))])
    return path


def assert_equal(read: Samples) -> None:
    np.testing.assert_allclose(read.time - read.time[0], SAMPLES.time, atol=1e-9)
    for channel in FOREIGN:
        bound = 1e-12 * float(np.ptp(SAMPLES[channel]))
        np.testing.assert_allclose(read[channel], SAMPLES[channel], rtol=0, atol=bound, err_msg=channel)


@pytest.mark.parametrize("kind", WRITERS)
def test_a_file_of_every_format_is_read(kind, tmp_path):
    path = file_of(kind, tmp_path)
    assert_equal(read_log(path, _with_time(path)).samples)


def _with_time(path: Path) -> ChannelMap:
    """The map, with the time column where the file has one and does not say what it is."""
    log, times = open_log(path), {}
    named = [s for s in log.signals if s.rsplit("/", 1)[-1] in ("time", "t")]
    if named and log.stamps(log.signals[named[0]].clock) is None:
        times = {"time": {"column": named[0]}}
    channels = MAP.model_dump(by_alias=True, exclude_defaults=True)["channels"]
    return ChannelMap.model_validate({"channels": {**channels, **times}})


@pytest.mark.parametrize("kind", ["HDF5", "MDF 4"])
def test_a_slow_signal_has_its_own_stamps(kind, tmp_path):
    text = "\n".join(f"{c}: {{column: {n}}}" for c, (n, _, _) in FOREIGN.items())
    channel_map = ChannelMap.from_yaml(text + "\noil_temperature: {column: oil_temperature}")
    log = read_log(file_of(kind, tmp_path), channel_map)
    assert_equal(log.samples)  # the units are the file's own
    there = np.flatnonzero(np.isfinite(log.samples["oil_temperature"]))
    np.testing.assert_allclose(log.samples.time[there], OIL_T, atol=1e-9)
    np.testing.assert_allclose(log.samples["oil_temperature"][there], 40.0 + OIL_T)


@pytest.mark.parametrize("kind", WRITERS)
@pytest.mark.parametrize("share", [0.3, 0.9])
def test_a_cut_file_is_read_as_far_as_it_goes_or_refused_in_one_line(kind, share, tmp_path):
    path = file_of(kind, tmp_path, share)
    try:
        log = read_log(path, _with_time(path))
    except ValueError as error:
        assert str(error).startswith(str(path)) and "\n" not in str(error)
    else:
        rows = len(log.samples)
        assert rows <= len(SAMPLES)
        np.testing.assert_allclose(log.samples["position"], SAMPLES["position"][:rows], atol=1e-9)


def test_a_name_that_two_groups_have_and_an_extra_that_is_not_there(tmp_path, monkeypatch):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for group in ("left", "right"):
            file[f"{group}/position"] = np.arange(10.0)
    line = refused_log(tmp_path / "a.h5", ChannelMap.from_yaml("position: {column: position}"))
    assert "2 columns are called 'position'" in line and "left/position, right/position" in line
    (tmp_path / "a.mf4").write_bytes(b"MDF     4.10    " + bytes(200))
    monkeypatch.setitem(sys.modules, "asammdf", None)
    monkeypatch.delitem(sys.modules, "fdd.logs.formats.mdf", raising=False)
    assert "pip install 'fdd[mdf]'" in refused_log(tmp_path / "a.mf4")


CHANNELS = ("time", "position", "pump_angle", "pressure_difference")


def rows(separator: str = ",", decimal: str = ".", thousands: str = "", stamps: Any = None) -> str:
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
def test_every_habit_gives_the_same_samples(habit, tmp_path):
    text, encoding = TEXTS[habit]
    (tmp_path / "log.csv").write_bytes(text.encode(encoding))
    log = read_log(tmp_path / "log.csv")
    np.testing.assert_allclose(log.samples.time, SAMPLES.time, atol=1e-6)
    for channel in CHANNELS[1:]:
        atol = 0.051 if channel == "pressure_difference" else 1e-9
        np.testing.assert_allclose(log.samples[channel], SAMPLES[channel], atol=atol, err_msg=channel)
    if "date" in habit or habit == "ISO dates, comma":
        assert log.start_ns == pd.Timestamp("2026-03-04 10:15:00").value


def test_columns_of_dates_and_clocks_rows_of_units_and_bad_cells(tmp_path):
    text = rows(",", ".", "", dated("%d.%m.%Y,%H:%M:%S.%f")).replace('"', "")
    (tmp_path / "log.csv").write_text("Datum,Uhrzeit,position,pump_angle,pressure_difference\n" + text)
    entries = "".join(f"{c}: {{column: {c}}}\n" for c in CHANNELS[1:])
    log = read_log(tmp_path / "log.csv", ChannelMap.from_yaml(entries + "time: {column: Datum Uhrzeit}"))
    np.testing.assert_allclose(log.samples.time, SAMPLES.time, atol=1e-6)
    text = "time,position,pump_angle,pressure_difference\ns,µm,°,bar\n" + rows()
    (tmp_path / "log.csv").write_bytes(text.encode("cp1252"))
    assert "more than any hydraulic circuit holds" in refused_log(tmp_path / "log.csv")  # 2e5 "bar"
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
def test_stamps_against_the_standard_library(stamps, form):
    texts = [s.strftime(form) for s in stamps]
    wanted = [datetime.strptime(t, form).replace(tzinfo=UTC).timestamp() for t in texts]
    seconds, start, _ = stamps_to_seconds(texts)
    np.testing.assert_allclose(seconds + start * 1e-9, wanted, atol=2e-6)
