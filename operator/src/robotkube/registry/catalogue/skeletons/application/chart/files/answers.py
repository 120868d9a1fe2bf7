"""What the service says to what it hears: put your own work here. node.py carries it, and knows ROS."""


def answer(text: str) -> str | None:
    """The text that is published for a text that was received; None: nothing is."""
    return text
