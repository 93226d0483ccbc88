"""All that a `serve.yaml` names, opened before anything is made: by `fdd serve --check`, and each start."""

from __future__ import annotations

import ssl
from pathlib import Path

from fdd.bounds import MOST_AXES
from fdd.diagnosis.model import Model
from fdd.errors import InputError
from fdd.files import require_writable
from fdd.service.config import Serve
from fdd.service.config_sources import read_secret
from fdd.service.http import Tokens
from fdd.service.profiles import Profiles
from fdd.service.sources import open_source
from fdd.unit import Unit


def check(config: Serve) -> None:
    """Open all files that the configuration names, and make none.

    Raises
    ------
    InputError : the first one that cannot be used: a profile, model, map, log, secret, certificate or folder.
    """
    require_writable(config.state, folder=True)
    Profiles(config.units, config.fallback)
    if isinstance(config.units, Path):
        if not config.units.is_dir():
            raise InputError("no such folder", where=config.units, mend="make it, or correct units")
        for profile in sorted(config.units.glob("*.yaml"))[:MOST_AXES]:
            Unit.load(profile)
    Model.load(config.model)
    if config.tokens is not None:
        Tokens.load(config.tokens)
    if config.listen.tls is not None:
        tls = config.listen.tls
        try:
            ssl.create_default_context(ssl.Purpose.CLIENT_AUTH).load_cert_chain(tls.cert, tls.key)
        except OSError as error:  # ssl's own errors are OSErrors
            raise InputError(
                f"cannot be used for TLS ({error.strerror or error})", where=f"{tls.cert}, {tls.key}"
            ) from None
    for source in config.sources:
        open_source(source).check()
    outputs = config.outputs
    if outputs.mqtt is not None:
        from fdd.service.broker_client import broker_client

        broker_client(outputs.mqtt, "check")
    for hook in outputs.webhooks:
        if hook.secret_file is not None:
            read_secret(hook.secret_file)
    if outputs.jsonl is not None:
        require_writable(outputs.jsonl)
    if outputs.recording is not None:
        require_writable(outputs.recording.folder, folder=True)
