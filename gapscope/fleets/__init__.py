"""Many cases at any address: found, fetched, diagnosed side by side, kept as Parquet, and compared."""
