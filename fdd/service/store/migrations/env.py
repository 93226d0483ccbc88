"""Run by Alembic for each migration, on the connection and in the transaction that it was handed."""

from alembic import context

context.configure(
    connection=context.config.attributes["connection"],
    version_table=context.config.attributes["version_table"],
)
context.run_migrations()
