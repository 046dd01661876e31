"""A frozen program needs the bundled models beside the modules."""

from PyInstaller.utils.hooks import collect_data_files

datas = collect_data_files("elf_runtime")
