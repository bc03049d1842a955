"""Many scans in one folder of Parquet files, asked together."""
