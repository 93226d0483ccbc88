"""Run by Alembic for each migration, on the connection and in the transaction that it was handed."""

from alembic import context

from fdd.service.store.migrating import VERSION_TABLE

context.configure(connection=context.config.attributes["connection"], version_table=VERSION_TABLE)
context.run_migrations()
