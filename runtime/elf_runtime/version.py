"""The version, in this one place: the package, its build and what it writes read it from here."""

__version__ = "0.1.0"
