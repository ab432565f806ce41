"""The stand-in's exceptions."""


class InvalidParameterTypeException(Exception):
    pass


class ParameterAlreadyDeclaredException(Exception):
    pass
