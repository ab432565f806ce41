"""Doctor: checks whether failstop can keep its promises on this computer, with this board."""
