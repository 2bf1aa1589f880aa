from uniforce_commands.train import main

if __name__ == "__main__":
    main()
