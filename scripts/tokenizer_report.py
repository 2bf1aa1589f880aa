from uniforce_commands.tokenizer_report import main

raise SystemExit(main())
