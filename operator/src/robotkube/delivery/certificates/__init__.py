"""Certificates of the platform: an authority that is made once, and servers' certificates, renewed in time"""
