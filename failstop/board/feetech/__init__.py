"""Feetech: servos of the STS series (STS3215) on one half-duplex bus: LeKiwi's three wheels, and its arm."""
