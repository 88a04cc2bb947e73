"""The picture of a platform's axes: its bodies in perspective beside the tree of its joints."""
