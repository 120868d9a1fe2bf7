"""Recordings: everything that belongs to one is stored exactly once, or its audit says where, why and since when not.

receiving thread        Recordings.offer -> Recorder.offer        never waits
thread per recording    Recorder: hash, segments, buckets         waits for the volume
thread per reaction     Journal: database, spool                  waits for the database
"""
