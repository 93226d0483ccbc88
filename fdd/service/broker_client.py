"""A client of an MQTT broker as the configuration describes it: user, password, TLS."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import paho.mqtt.client as paho

from fdd.errors import InputError
from fdd.service.config_sources import Broker

_MOST_PASSWORD_BYTES = 4096


def broker_name(config: Broker) -> str:
    """How error lines call a broker.

    Examples
    --------
    >>> broker_name(Broker(host="broker.example.org"))
    'mqtt broker.example.org:1883'
    """
    return f"mqtt {config.host}:{config.chosen_port}"


def broker_client(config: Broker, client_id: str, **more: Any) -> paho.Client:
    """A client that is not connected yet.

    Parameters
    ----------
    client_id : of the session. more : for paho.

    Raises
    ------
    InputError : password file, certificate or key cannot be read.

    Examples
    --------
    >>> broker_client(Broker(host="broker.example.org"), "sender").is_connected()
    False
    """
    client = paho.Client(
        paho.CallbackAPIVersion.VERSION2,
        client_id=client_id,
        protocol=paho.MQTTv5 if config.version == "5" else paho.MQTTv311,
        **more,
    )
    if config.user is not None:
        client.username_pw_set(config.user, _password(config.password_file))
    if config.tls is not None:
        tls = config.tls
        try:
            client.tls_set(ca_certs=_text(tls.ca), certfile=_text(tls.cert), keyfile=_text(tls.key))
        except (OSError, ValueError) as error:  # ssl's own errors are OSErrors
            raise InputError(
                f"TLS cannot be set up ({error})", where=broker_name(config), mend="check ca, cert and key"
            ) from None
    return client


def _text(path: Path | None) -> str | None:
    return None if path is None else str(path)


def _password(path: Path | None) -> str | None:
    if path is None:
        return None
    try:
        with path.open("rb") as file:
            lines = file.read(_MOST_PASSWORD_BYTES).splitlines()
        return lines[0].decode() if lines else ""
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8"
        raise InputError(
            f"the password cannot be read ({reason})", where=path, mend="correct password_file"
        ) from None
