"""CAN protocols of motor controllers. A new controller is one file here and one line in `DRIVERS`."""
