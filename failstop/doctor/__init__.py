"""Doctor: whether this machine and this board let failstop do what it promises. Facts are gathered, then judged."""
