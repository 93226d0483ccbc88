"""The first tables."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None

BIG = sa.BigInteger().with_variant(sa.Integer, "sqlite")


def upgrade() -> None:
    """Make them."""
    op.create_table(
        "meta",
        sa.Column("key", sa.Text, primary_key=True),
        sa.Column("value", sa.Text, nullable=False),
    )
    op.create_table(
        "axis",
        sa.Column("name", sa.Text, primary_key=True),
        sa.Column("unit", sa.Text),
        sa.Column("profile_sha256", sa.Text),
        sa.Column("model_sha256", sa.Text),
        sa.Column("first_wall", sa.Double, nullable=False),
        sa.Column("last_wall", sa.Double, nullable=False),
        sa.Column("last_time", sa.Double),
        sa.Column("state", sa.Text),
    )
    op.create_table(
        "finding",
        sa.Column("id", BIG, primary_key=True),
        sa.Column("axis", sa.Text, nullable=False),
        sa.Column("time", sa.Double, nullable=False),
        sa.Column("wall", sa.Double, nullable=False),
        sa.Column("onset", sa.Double),
        sa.Column("fault", sa.Text, nullable=False),
        sa.Column("family", sa.Text, nullable=False),
        sa.Column("confidence", sa.Double, nullable=False),
        sa.Column("severity", sa.Double),
        sa.Column("low", sa.Double),
        sa.Column("high", sa.Double),
        sa.Column("body", sa.JSON, nullable=False),
        sqlite_autoincrement=True,
    )
    op.create_index("finding_by_axis", "finding", ["axis", "wall"])
    op.create_table(
        "alarm",
        sa.Column("id", sa.BigInteger, primary_key=True, autoincrement=False),
        sa.Column("axis", sa.Text, nullable=False),
        sa.Column("key", sa.Text, nullable=False),
        sa.Column("state", sa.Text, nullable=False),
        sa.Column("priority", sa.Text, nullable=False),
        sa.Column("raised_time", sa.Double, nullable=False),
        sa.Column("raised_wall", sa.Double, nullable=False),
        sa.Column("returned_wall", sa.Double),
        sa.Column("acked_by", sa.Text),
        sa.Column("acked_wall", sa.Double),
        sa.Column("shelved_by", sa.Text),
        sa.Column("shelved_until", sa.Double),
        sa.Column("count", sa.Integer, nullable=False),
        sa.Column("chattering", sa.Boolean, nullable=False),
        sa.Column("note", sa.Text, nullable=False),
        sa.Column("body", sa.JSON, nullable=False),
    )
    op.create_index("alarm_by_key", "alarm", ["axis", "key", "id"])
    op.create_index("alarm_by_state", "alarm", ["state"])
    op.create_table(
        "audit",
        sa.Column("id", BIG, primary_key=True),
        sa.Column("wall", sa.Double, nullable=False),
        sa.Column("time", sa.Double),
        sa.Column("who", sa.Text, nullable=False),
        sa.Column("action", sa.Text, nullable=False),
        sa.Column("alarm_id", sa.BigInteger),
        sa.Column("axis", sa.Text),
        sa.Column("note", sa.Text, nullable=False),
        sa.Column("body", sa.JSON, nullable=False),
        sqlite_autoincrement=True,
    )
    op.create_index("audit_by_alarm", "audit", ["alarm_id"])
    op.create_table(
        "rollup",
        sa.Column("axis", sa.Text, primary_key=True),
        sa.Column("quantity", sa.Text, primary_key=True),
        sa.Column("level", sa.Text, primary_key=True),
        sa.Column("start_wall", sa.Double, primary_key=True),
        sa.Column("n", sa.BigInteger, nullable=False),
        sa.Column("mean", sa.Double, nullable=False),
        sa.Column("std", sa.Double, nullable=False),
        sa.Column("min", sa.Double, nullable=False),
        sa.Column("max", sa.Double, nullable=False),
        sqlite_with_rowid=False,
    )
    op.create_index("rollup_by_age", "rollup", ["level", "start_wall"])
    op.create_table(
        "quality",
        sa.Column("axis", sa.Text, primary_key=True),
        sa.Column("start_wall", sa.Double, primary_key=True),
        *(
            sa.Column(name, sa.BigInteger, nullable=False)
            for name in ("dropped", "late", "repeated", "gaps", "nan")
        ),
    )
    op.create_table(
        "checkpoint",
        sa.Column("axis", sa.Text, primary_key=True),
        sa.Column("time", sa.Double, nullable=False),
        sa.Column("wall", sa.Double, nullable=False),
        sa.Column("sequence", sa.BigInteger, nullable=False),
        sa.Column("profile_sha256", sa.Text, nullable=False),
        sa.Column("model_sha256", sa.Text, nullable=False),
        sa.Column("version", sa.Text, nullable=False),
        sa.Column("body", sa.LargeBinary, nullable=False),
        sa.Column("sha256", sa.Text, nullable=False),
    )
    op.create_table(
        "journal",
        sa.Column("id", BIG, primary_key=True),
        sa.Column("axis", sa.Text, nullable=False),
        sa.Column("payload", sa.LargeBinary, nullable=False),
        sqlite_autoincrement=True,
    )
    op.create_index("journal_by_axis", "journal", ["axis", "id"])
    op.create_table(
        "outbox",
        sa.Column("id", BIG, primary_key=True),
        sa.Column("kind", sa.Text, nullable=False),
        sa.Column("body", sa.JSON, nullable=False),
        sa.Column("target", sa.Text, nullable=False),
        sa.Column("attempts", sa.Integer, nullable=False),
        sa.Column("next_wall", sa.Double, nullable=False),
        sa.Column("done", sa.Boolean, nullable=False, server_default=sa.false()),
        sqlite_autoincrement=True,
    )
    op.create_index(
        "outbox_to_do",
        "outbox",
        ["target", "id"],
        sqlite_where=sa.text("NOT done"),
        postgresql_where=sa.text("NOT done"),
    )
