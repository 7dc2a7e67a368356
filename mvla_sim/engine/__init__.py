"""What the program computes on: libLLVM, the Dr.Jit backend, this machine and its versions."""
