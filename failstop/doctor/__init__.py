"""Doctor: whether this machine and this board let failstop do what it promises. Each check looks, and judges."""
