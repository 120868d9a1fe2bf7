"""The event detector: live topics -> ring buffers -> rules -> reactions.

detector            one turn: receive, buffer, evaluate, react
subscriptions       subscriptions and their QoS, found by patterns; subscription: one of them
input_counters      counters of a topic, as /input shows them; pattern_counters: their sums by pattern
dispatching         edges to reactions and /events; recording: edges and messages to recordings
broker              topics and notifications over one MQTT connection
status              /status and /metrics
rule_replay         rules on bags
"""
