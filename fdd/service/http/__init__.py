"""The HTTP service: API, events, page and what guards them."""

from fdd.service.http.app import web
from fdd.service.http.callers import Tokens, new_token
from fdd.service.http.doors import Action
from fdd.service.http.events import Hub
from fdd.service.http.server import Listen, Server
from fdd.service.http.uploads import Folders

__all__ = ["Action", "Folders", "Hub", "Listen", "Server", "Tokens", "new_token", "web"]
