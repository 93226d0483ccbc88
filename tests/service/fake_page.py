"""Look at the page: ``python -m tests.service.fake_page [port]`` serves a fleet that is made up."""

from __future__ import annotations

import sys
import threading
import time

from fdd.diagnosis.findings import FaultFinding
from fdd.service.http import Hub, Listen, Server, web
from tests.service.fake import FakeBus, FakeFleet, FakeStore, fake

METRICS = (b"fdd_axes 14\n", "text/plain; version=0.0.4; charset=utf-8")


def made_up() -> tuple[FakeFleet, FakeStore, FakeBus]:
    fleet, store, bus = fake()
    leak = FaultFinding(
        fault="internal_leakage",
        family="leakage",
        ambiguity=["internal_leakage", "pump_wear"],
        shares={"internal_leakage": 0.72, "pump_wear": 0.28},
        confidence=0.97,
        onset_s=408.2,
        detected_s=424.0,
        severity=0.41,
        severity_interval=(0.35, 0.48),
        evidence=[
            "The balance of the chambers' oil does not close from 408.2 s on; internal leakage of severity "
            "0.41 ± 0.05 explains it (log likelihood ratio 38.2, from 95 stretches of 2 s).",
            "In this log they would look alike: internal leakage 72 %, pump wear 28 %.",
        ],
        next_check="Block the cylinder and measure the pump speed that holds 5 MPa: "
        "leakage of the cylinder remains, that of the pump goes with its speed.",
    )
    air = FaultFinding(
        fault="aeration",
        family="aeration",
        ambiguity=["aeration"],
        confidence=0.91,
        onset_s=402.0,
        detected_s=431.0,
        severity=0.22,
        severity_interval=(0.16, 0.29),
        evidence=["The bulk modulus fell from 1160 to 890 MPa."],
        next_check="Bleed both chambers and look for bubbles.",
    )
    fleet.add(
        "F7/aileron-R",
        state="in alarm",
        headline="Internal leakage, since 408 s, severity 0.41, 97 % sure",
        factors={"leakage": 1.5},
        family="leakage",
        findings=[leak],
        misfit="volume",
    )
    fleet.add(
        "F7/rudder",
        state="in alarm",
        headline="Air in the oil, since 402 s, severity 0.22, 91 % sure",
        factors={"bulk_modulus": 0.77},
        family="aeration",
        findings=[air],
        misfit="coherence",
    )
    fleet.add(
        "F3/elevator-L",
        state="in alarm",
        headline="Actuator seal wear, since 398 s, severity 0.31, 88 % sure",
        factors={"coulomb_friction": 1.3, "viscous_friction": 1.2},
        family="seal_wear",
        misfit="force",
    )
    fleet.add(
        "F3/spoiler-2",
        state="in alarm",
        headline="Pressure sensor bias on pressure 1, since 405 s, 99 % sure",
        family="sensor",
        misfit="coherence",
    )
    fleet.add("rig-2/axis-B", state="silent", headline="Silent for 13 min; healthy before")
    fleet.add("rig-2/axis-C", state="failed", headline="Stopped: columns in another unit of measure")
    fleet.add("F9/aileron-L", state="learning", headline="Learning: 40 s of 60 s seen")
    for name in (
        "F7/aileron-L",
        "F7/elevator-L",
        "F7/elevator-R",
        "F3/aileron-L",
        "F3/aileron-R",
        "F3/rudder",
        "rig-1/axis-A",
    ):
        fleet.add(name)
    now = time.time()
    ids = [
        fleet.raise_alarm(
            "F3/spoiler-2",
            "pressure_sensor_bias",
            "sensor",
            "low",
            channel="pressure_1",
            raised_wall=now - 5200,
            severity=None,
            confidence=0.99,
        ),
        fleet.raise_alarm(
            "F3/elevator-L",
            "seal_wear",
            "seal_wear",
            "medium",
            raised_wall=now - 2600,
            severity=0.31,
            confidence=0.88,
            count=4,
            chattering=True,
        ),
        fleet.raise_alarm(
            "F7/rudder", "aeration", "aeration", "high", raised_wall=now - 400, severity=0.22, confidence=0.91
        ),
        fleet.raise_alarm(
            "F7/aileron-R",
            "internal_leakage",
            "leakage",
            "urgent",
            raised_wall=now - 176,
            body={"finding": leak.model_dump()},
        ),
        fleet.raise_alarm(
            "rig-1/axis-A",
            "sensor_dropout",
            "sensor",
            "medium",
            channel="motor_current",
            raised_wall=now - 90000,
        ),
    ]
    from fdd.service.http import Action

    fleet.act(Action("acknowledge", ids[1], "r.meier", "Seal kit ordered, watch until Friday"))
    fleet.act(Action("shelve", ids[0], "a.sato", "Sensor is exchanged at the next stop", now + 7200))
    fleet.act(Action("acknowledge", ids[4], "r.meier", "Connector reseated"))
    store.rows[ids[4]] |= {"state": "NORMAL", "returned_wall": now - 86000}
    fleet._count("rig-1/axis-A")
    return fleet, store, bus


def main() -> None:
    port = int(sys.argv[1]) if len(sys.argv) > 1 else 8080
    fleet, store, bus = made_up()
    stop, hub = threading.Event(), Hub(bus)
    hub.start(stop)
    health = {"status": "ok", "problems": [], "axes": len(fleet.details)}
    app = web(fleet=fleet, store=store, hub=hub, health=lambda: health, metrics=lambda accept: METRICS)
    server = Server(app, Listen(port=port), has_tokens=False)
    server.start(stop)
    print(server.address, flush=True)
    try:
        while True:
            time.sleep(5.0)
            for detail in fleet.details.values():
                if detail.status.state not in ("silent", "failed"):
                    detail.status.last_wall = time.time()
                    bus.publish("status", detail.status.name)
    except KeyboardInterrupt:
        stop.set()


if __name__ == "__main__":
    main()
