"""Damaged files, hostile files, kills, full disks: ``python -m tests.faults`` tries them all."""
