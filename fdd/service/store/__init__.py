"""What the service keeps: SQLite in a file, or PostgreSQL."""

from fdd.service.store.checkpoints import Checkpoint, joined, parted
from fdd.service.store.rollups import Rollup
from fdd.service.store.store import Parcel, Store
from fdd.service.store.transaction import Transaction
from fdd.service.store.troubles import LeaseLost, StoreTrouble

__all__ = [
    "Checkpoint", "LeaseLost", "Parcel", "Rollup", "Store", "StoreTrouble", "Transaction", "joined", "parted",
]  # fmt: skip
