"""serve.yaml, the unit of systemd and the container file: what may stand in them, and what may not."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from fdd.errors import InputError
from fdd.service.config import Serve
from fdd.service.config_sources import FolderSource, MqttSource, ReplaySource

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "serve.yaml"
UDP = "sources: [{type: udp, port: 9000}]"


def of(text: str) -> Serve:
    return Serve.from_yaml("schema: fdd.serve/1\n" + text)


def test_the_example_is_read_with_paths_from_its_folder():
    found = Serve.load(EXAMPLE)
    here = EXAMPLE.parent
    mqtt, folder, replay = found.sources[0], found.sources[3], found.sources[4]
    assert [type(each) for each in (mqtt, folder, replay)] == [MqttSource, FolderSource, ReplaySource]
    assert mqtt.password_file == here / "mqtt.password" and mqtt.chosen_port == 8883
    assert mqtt.tls is not None and mqtt.tls.ca == here / "ca.pem"
    assert folder.folder == here / "drop" and replay.logs == {"demo": here / "run.mcap"}
    assert found.outputs.recording is not None and found.outputs.recording.folder == here / "recordings"
    assert found.outputs.webhooks[0].secret_file == here / "webhook.secret"
    assert found.store_url == f"sqlite:///{here / 'state' / 'fdd.db'}"


def test_absolute_paths_stay_and_without_tokens_only_this_machine_is_listened_on(tmp_path):
    text = f"schema: fdd.serve/1\nstore: postgresql://db/fdd\nstate: /var/lib/fdd\n{UDP}"
    found = Serve.from_yaml(text, folder=Path("etc"))
    assert found.store_url == "postgresql://db/fdd" and found.state == Path("/var/lib/fdd")
    for host in ("127.0.0.1", "::1", "localhost", "127.8.8.8"):
        assert of(f"{UDP}\nlisten: {{host: '{host}'}}").listen.is_local
    assert not of(f"{UDP}\nlisten: {{host: 0.0.0.0}}\ntokens: tokens").listen.is_local
    (tmp_path / "a.yaml").write_text("schema: fdd.map/1")
    told = {"a": "not a configuration of fdd serve; its first line", "b": "no such configuration"}
    for name, words in told.items():
        with pytest.raises(InputError, match=rf"{name}.yaml: {words}"):
            Serve.load(tmp_path / f"{name}.yaml")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("sources: []", "sources: "),
        ("sources: [{type: modbus}]", "sources.0: .*'modbus'"),
        ("sources: [{type: udp, port: 70000}]", "sources.0.udp.port"),
        ("sources: [{type: udp, port: 1, axis: ../x}]", "no name of an axis"),
        ("sources: [{type: udp, port: 1}, {type: udp, port: 2}]", "'udp' twice; give each a name"),
        ("sources: [{type: udp, port: 1, prot: 2}]", "sources.0.udp.prot: unknown key"),
        ("sources: [{type: mqtt, host: b, topics: ['a/#/b']}]", "stand for whole levels"),
        ("sources: [{type: mqtt, host: b, topics: ['a+/b']}]", "stand for whole levels"),
        ("sources: [{type: mqtt, host: b, topics: ['x{axis}/b']}]", "one whole level"),
        ("sources: [{type: mqtt, host: b, topics: [a], password_file: p}]", "needs a user"),
        ("sources: [{type: mqtt, host: b, topics: [a], tls: {cert: c}}]", "go together"),
        ("sources: [{type: replay, logs: {}}]", "sources.0.replay.logs"),
        ("sources: [{type: replay, logs: {A1: a.csv}, speed: .inf}]", "sources.0.replay.speed"),
        (f"{UDP}\nlisten: {{host: 0.0.0.0}}", "0.0.0.0 is open to others and needs tokens"),
        (f"{UDP}\nlisten: {{host: '::'}}", "needs tokens"),
        (f"{UDP}\noutputs: {{webhooks: [{{url: 'file:///etc/passwd'}}]}}", "no address of http or https"),
        (f"{UDP}\nlimits: {{hold: 2}}", "limits.hold"),
        (f"{UDP}\nzone: Europe/Pari", "'Europe/Pari' is no time zone"),
        (f"{UDP}\nzone: {{A1: Mars}}", "'Mars' is no time zone"),
        (f"{UDP}\nstoer: x", "stoer: unknown key"),
        ("sorces: []", r"sorces: unknown key \(did you mean 'sources'\?\)"),
        (f"{UDP}\n{UDP}", "twice"),
    ],
)
def test_what_is_wrong_is_told_in_one_line(text, told):
    with pytest.raises(InputError, match=told) as caught:
        of(text)
    assert str(caught.value).startswith("serve.yaml: ") and "\n" not in str(caught.value)


def test_the_unit_is_hardened():
    if shutil.which("systemd-analyze") is None:
        pytest.skip("no systemd-analyze on this machine")
    unit = ROOT / "deploy" / "fdd.service"
    asked = ["systemd-analyze", "security", "--offline=true"]
    if subprocess.run([*asked, "--help"], capture_output=True).returncode:
        pytest.skip("this systemd-analyze judges running services alone")
    # Ten times the exposure, from 0 (safe) to 100; a service of no settings has 96.
    judged = subprocess.run([*asked, "--threshold=15", unit], capture_output=True, text=True)
    assert judged.returncode == 0, judged.stdout[-300:] + judged.stderr


def test_the_container_takes_files_that_there_are_and_runs_without_root():
    text = (ROOT / "deploy" / "Containerfile").read_text()
    for names in re.findall(r"^COPY (?!--from)(.+) \S+$", text, re.M):
        assert all((ROOT / name).exists() for name in names.split())
    users = re.findall(r"^USER (\d+)", text, re.M)
    assert users and int(users[-1]) >= 1000
    assert text.index("\nUSER ") < text.index("\nENTRYPOINT ")
