"""MQTT 5: a connection to the broker, packets, properties, batches of messages."""
