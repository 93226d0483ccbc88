"""The HTTP service: API, events and page."""

from fdd.service.http.app import Server, web
from fdd.service.http.tokens import Tokens, new_token

__all__ = ["Server", "Tokens", "new_token", "web"]
