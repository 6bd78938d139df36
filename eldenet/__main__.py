"""``python -m eldenet``: the list of commands; ``python -m eldenet train ...`` starts one."""

from eldenet.cli.commands import main

if __name__ == "__main__":
    main()
