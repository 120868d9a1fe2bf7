"""The event detector: live topics -> ring buffers -> rules -> reactions.

detector        one turn: take, buffer, evaluate, react           topics        subscriptions and their quality
counting        what arrived, as /input shows it                  raising       edges to reactions and /events
broker          topics and messages over one MQTT connection      status        /status and /metrics
"""
