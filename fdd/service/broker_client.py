"""A client of an MQTT broker as the configuration describes it: user, password, TLS."""

from __future__ import annotations

from typing import Any

import paho.mqtt.client as paho

from fdd.errors import InputError
from fdd.service.config_sources import Broker, read_secret


def broker_name(config: Broker) -> str:
    """How error lines call a broker."""
    return f"mqtt {config.host}:{config.chosen_port}"


def broker_client(config: Broker, client_id: str, **more: Any) -> paho.Client:
    """A client that is not connected yet.

    Parameters
    ----------
    client_id : of the session. more : for paho.

    Raises
    ------
    InputError : password file, certificate or key cannot be read.
    """
    client = paho.Client(
        paho.CallbackAPIVersion.VERSION2,
        client_id=client_id,
        protocol=paho.MQTTv5 if config.version == "5" else paho.MQTTv311,
        **more,
    )
    if config.user is not None:
        password = None if config.password_file is None else read_secret(config.password_file)
        client.username_pw_set(config.user, password)
    if config.tls is not None:
        tls = config.tls
        try:
            ca, cert, key = (None if path is None else str(path) for path in (tls.ca, tls.cert, tls.key))
            client.tls_set(ca_certs=ca, certfile=cert, keyfile=key)
        except (OSError, ValueError) as error:  # ssl's own errors are OSErrors
            named = ", ".join(str(path) for path in (tls.ca, tls.cert, tls.key) if path is not None)
            raise InputError(
                f"TLS cannot be set up ({error})", where=named or broker_name(config),
                mend="check ca, cert and key",
            ) from None  # fmt: skip
    return client
