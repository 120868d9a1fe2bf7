"""What a detector does about events: tasks, and messages to whoever asked for them.

operator      a TaskDescription while an event lasts
deliveries    signed webhooks, installed reactions: a queue, a thread, retries
keeping       what waits for delivery, on the disk
dead          what was given up
"""
