"""The runtime's commands; one file each, and `_common` for what they share."""
