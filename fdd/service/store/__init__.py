"""What the service keeps: SQLite in a file, or PostgreSQL."""

from fdd.service.store.database import LeaseLost, StoreTrouble
from fdd.service.store.records import Checkpoint, Rollup
from fdd.service.store.store import OutboxMessage, Store, Transaction

__all__ = ["Checkpoint", "LeaseLost", "OutboxMessage", "Rollup", "Store", "StoreTrouble", "Transaction"]
