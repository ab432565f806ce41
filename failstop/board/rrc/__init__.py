"""RRC: the STM32 controller of Hiwonder's ROSOrin family."""
