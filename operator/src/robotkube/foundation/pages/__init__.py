"""Asking the platform's processes over HTTP: their pages, and questions to them."""
