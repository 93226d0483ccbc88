"""What the service keeps: SQLite in a file, or PostgreSQL."""

from fdd.service.store.checkpoints import Checkpoint
from fdd.service.store.rollups import Rollup
from fdd.service.store.store import Parcel, Store
from fdd.service.store.transaction import Transaction
from fdd.service.store.troubles import StoreTrouble

__all__ = ["Checkpoint", "Parcel", "Rollup", "Store", "StoreTrouble", "Transaction"]
