"""Builders of documents, and parts that several documents share."""
