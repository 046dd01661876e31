"""Seeded damage to files: what a hostile or broken one may look like."""
