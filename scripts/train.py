from uniforce_vtla.commands.train import main

if __name__ == "__main__":
    main()
