"""Every reader of files, given valid files of its format that were damaged on purpose (docs/reliability.md)."""
