"""The exporter imports its networks by name, and reads the photographs that it calibrates with."""

from PyInstaller.utils.hooks import collect_data_files, collect_submodules

datas = collect_data_files("elf_export")
hiddenimports = collect_submodules("elf_export")
