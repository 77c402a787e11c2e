"""Driving by hand: what keys and gamepads say, and what is made of it. Pure; what reads them is elsewhere."""
