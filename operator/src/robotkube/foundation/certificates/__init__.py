"""Certificates: made by an authority of one's own, and verified by whoever connects"""
