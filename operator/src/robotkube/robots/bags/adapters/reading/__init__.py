"""Bags as robots record them, also such that were never seen: rosbag2 folders (MCAP or sqlite3) and single files.

opening      a path -> a bag: all its files merged by time       metadata     metadata.yaml and its QoS profiles
mcap_files   one MCAP file, by its index or by going through it   mcap_records its records
sqlite_files one sqlite3 file                                     compression  zstd and lz4, within bounds

Messages come in the order of their times, whatever their order in the files. Only what is asked for is read: with an
index the messages of other topics are not touched. Damage is reported to `complain`; when that returns, what is
readable is used.
"""

from robotkube.robots.bags.adapters.reading.opening import OpenBag, open_bag

__all__ = ["OpenBag", "open_bag"]
