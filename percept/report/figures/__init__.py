"""Figures in two layers: arrays to axes (`curves`, `marks`), and a document to arrays (`from_document`)."""
