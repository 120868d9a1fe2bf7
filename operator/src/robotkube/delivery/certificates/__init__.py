"""Certificates of the platform: an authority that is made once, and the broker's certificate, renewed in time"""
