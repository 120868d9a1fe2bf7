"""Reactions of a detector to events: tasks, and notifications.

operator           a TaskDescription while an event lasts
deliveries         signed webhooks, installed reactions: a queue, a thread, retries
fenced_sender      a sender that sends nothing while the release is fenced
delivery_journal   deliveries that wait, on the disk
dead_letters       deliveries that were given up
"""
