"""The simulated board on USB: a CDC-ACM device that a real kernel's own driver takes for a plug.

descriptors, acm, usbip and usbredir are pure: bytes and times in, bytes out. vhci and port have the descriptors.
"""
