"""The command `spm-pin` as `python -m spm_pin`."""

from spm_pin.cli import main

if __name__ == "__main__":
    main()
