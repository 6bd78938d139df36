"""Damaged files, hostile files, kills, full disks: what eldenet does then. ``python -m tests.faults`` runs all."""
