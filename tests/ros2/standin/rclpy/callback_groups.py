"""The stand-in's callback groups: the node's own is mutually exclusive."""


class ReentrantCallbackGroup:
    pass
