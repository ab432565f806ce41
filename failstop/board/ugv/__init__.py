"""UGV: Waveshare UGV Rover, Beast and RaspRover, whose ESP32 takes lines of JSON."""
