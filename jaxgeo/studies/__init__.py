"""The papers' tables and figures, made again from the same functions that users call."""
