"""Feetech: servos of the STS series (STS3215) on one half-duplex bus. LeKiwi has three for its wheels, and more for its
arm."""
