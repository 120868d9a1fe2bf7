"""The database: a connection, and accounts with their roles."""
