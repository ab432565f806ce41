"""The service on a stock Debian in a virtual machine: its kernel's own cdc_acm, udev, systemd, sleep and boot.

`make vm` runs it; tests/vm/README.md says what it shows. On the machine: image (what is booted), guest (one virtual
machine), outside (the trials whose board outlives the guest's kernel), __main__. In the guest: agent (runs what it is
told), inside (the other trials). table: the trials, and what they must show.
"""
