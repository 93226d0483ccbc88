"""What tests of the store share: a finding, a time, and an emptied database."""

from __future__ import annotations

from postgres_server import postgres_server
from sqlalchemy import create_engine, text

from fdd.diagnosis.findings import FaultFinding

WALL = 1_700_000_000.0
LEAK = FaultFinding(
    fault="pump_wear", family="leakage", ambiguity=["pump_wear"], confidence=0.9, onset_s=3.0,
    detected_s=15.0, severity=0.6, severity_interval=(0.5, 0.7),
)  # fmt: skip


def blocks_of(axis: str, payloads: list[bytes]) -> list[tuple[str, bytes]]:
    """As a transaction accepts them."""
    return [(axis, payload) for payload in payloads]


def postgres_url() -> str:
    """An emptied database on a server of our own, or the test is skipped."""
    url = postgres_server().url
    engine = create_engine(url.replace("postgresql://", "postgresql+psycopg://"))
    with engine.begin() as connection:
        connection.execute(text("DROP SCHEMA public CASCADE"))
        connection.execute(text("CREATE SCHEMA public"))
    engine.dispose()
    return url
