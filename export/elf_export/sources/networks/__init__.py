"""The networks that `elf-export --net` knows; one file each."""

from __future__ import annotations

from .registry import Network, get_network, network_names

__all__ = ["Network", "get_network", "network_names"]
